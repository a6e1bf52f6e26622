"""Positions of the joints of boom and leg: the closed chain of Fig. 1 in MuJoCo's frame of the twin.

x points forward at yaw 0, y to the boom's pivot side, z up from the floor; the pivot stands over the origin. The leg
swings in the plane of the boom's tip: `forward` along the circle, `up` perpendicular to the boom, tilted by its pitch.
"""

from collections.abc import Mapping
from math import asin, tau
from typing import NamedTuple

import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.model.leg import knee_angle, leg_of
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.scene import Kinematics, Link, Motion, Scene
from stepgap.step import Array

TRUE_UNITS: Mapping[str, str] = {
    "hip_x": "m",
    "hip_height": "m",
    "boom_yaw": "rad",
    "boom_pitch": "rad",
    "true_alpha_1": "rad",
    "true_alpha_2": "rad",
    "foot_x": "m",
    "foot_y": "m",
    "foot_z": "m",
    "ground_height": "m",
}
"""Columns of the true state of the twin at the reading of the sensors, after those of a tick.

The hip's x is the distance travelled along the circle; the foot is in MuJoCo's frame, whose z points up from the floor.
"""

JOINTS: Mapping[str, float] = {
    "base": 0.0,
    "pivot": 0.0,
    "hip": 0.035,
    "front_knee": 0.012,
    "rear_knee": 0.012,
    "ankle": 0.010,
    "foot": 0.009,
}
"""Points of boom and leg, with the radii of their balls [m].

The front knee is on the link that motor 1 drives, at α₁ + α₂, the rear knee on that of motor 2, at α₁ − α₂. The ankle
is the common joint of the bottom links, and the foot the end of the rear knee's bottom link.
"""

LINKS = (
    Link("base", "pivot", 0.02),
    Link("pivot", "hip", 0.010),
    Link("hip", "front_knee", 0.008, "near"),
    Link("front_knee", "ankle", 0.006, "near"),
    Link("hip", "rear_knee", 0.008, "far"),
    Link("rear_knee", "foot", 0.006, "far"),
)

LEG_SIGNALS: Mapping[str, str] = {
    "leg length": "m",
    "leg angle": "rad",
    "torque of motor 1": "N·m",
    "torque of motor 2": "N·m",
}
"""What is drawn over time: the measured leg from the hip to the ankle, and the torques that were applied."""

TOUCHING_FORCE = 1.0  # Ground force above which the foot is drawn as touching the ground [N]


class HopperPose(NamedTuple):
    """Poses of boom and leg; numbers, or arrays of shape (F,).

    Attributes:
        yaw: Horizontal boom angle [rad].
        pitch: Vertical boom angle, upward positive [rad].
        alpha_1: Leg angle α₁ [rad].
        alpha_2: Half the angle between the top links α₂ [rad].
        deflection_forward: Forward deflection of an elastic boom's tip [m].
        deflection_up: Upward deflection of an elastic boom's tip [m].
    """

    yaw: Array | float
    pitch: Array | float
    alpha_1: Array | float
    alpha_2: Array | float
    deflection_forward: Array | float = 0.0
    deflection_up: Array | float = 0.0


class HopperKinematics(Kinematics):
    """Kinematics of the hopper.

    Args:
        robot: Lengths of the robot.
        gains: Gains of the joint controller, which determine the posture at the apex.
        sensors: Sensor model of the rig.
    """

    def __init__(self, robot: RobotParameters, gains: Gains, sensors: HopperSensorModel):
        self._robot = robot
        self._gains = gains
        self._sensors = sensors

    @property
    def scene(self) -> Scene:
        """Boom and leg on their circle."""
        return Scene(
            JOINTS, LINKS, "hip", ("foot",), "height", self._robot.boom_length, LEG_SIGNALS, foothold="foothold"
        )

    @property
    def units(self) -> Mapping[str, str]:
        """Columns of a tick."""
        return TICK_UNITS

    @property
    def observed_units(self) -> Mapping[str, str]:
        """Columns of a tick with the true state of the twin."""
        return {**TICK_UNITS, **TRUE_UNITS}

    @property
    def tick(self) -> float:
        """Time between two reads of the sensors [s]."""
        return self._sensors.tick

    def motion(self, ticks: TickTable) -> Motion:
        """Motion in ticks; measured motion is on level ground, without the deflection of the boom."""
        seen = "boom_yaw" in ticks.units
        pose = self._true_pose(ticks) if seen else self._measured_pose(ticks)
        return Motion(
            ticks["time"],
            ticks["step"],
            joint_positions(self._robot, self._sensors.pivot_height, pose),
            np.asarray(ticks["contact_force"] > TOUCHING_FORCE, float)[:, None],
            ticks["ground_height"] if seen else np.zeros(len(ticks)),
            self._signals(ticks),
        )

    def at_section(self, state: Array) -> Array:
        """At the apex, at yaw 0, with the leg in the landing posture."""
        speed, height = state[:2]
        pitch = asin(np.clip((height - self._sensors.pivot_height) / self._robot.boom_length, -1, 1))
        alpha_1 = self._gains.speed_gain * (speed - self._gains.speed_setpoint)
        alpha_2 = knee_angle(leg_of(self._robot), self._gains.landing_length)
        return joint_positions(self._robot, self._sensors.pivot_height, HopperPose(0.0, pitch, alpha_1, alpha_2))

    def _signals(self, ticks: TickTable) -> Array:
        """Measured values of `LEG_SIGNALS`; shape (F, 4)."""
        top = self._robot.top_length
        bottom = self._robot.bottom_length
        alpha_1 = ticks["alpha_1"]
        alpha_2 = ticks["alpha_2"]
        length = top * np.cos(alpha_2) + np.sqrt(bottom**2 - (top * np.sin(alpha_2)) ** 2)
        return np.column_stack([length, alpha_1, ticks["applied_1"], ticks["applied_2"]])

    def _measured_pose(self, ticks: TickTable) -> HopperPose:
        yaw = ticks["boom_horizontal"] * tau / self._sensors.boom_counts_horizontal
        pitch = ticks["boom_vertical"] * tau / self._sensors.boom_counts_vertical
        return HopperPose(yaw, pitch, ticks["alpha_1"], ticks["alpha_2"])

    def _true_pose(self, ticks: TickTable) -> HopperPose:
        yaw = ticks["boom_yaw"]
        pitch = ticks["boom_pitch"]
        radius = self._sensors.boom_length
        along = ticks["hip_x"] - radius * yaw
        across = (ticks["hip_height"] - self._sensors.pivot_height - radius * np.sin(pitch)) / np.cos(pitch)
        return HopperPose(
            yaw=yaw, pitch=pitch, alpha_1=ticks["true_alpha_1"], alpha_2=ticks["true_alpha_2"],
            deflection_forward=along, deflection_up=across,
        )  # fmt: skip


def joint_positions(robot: RobotParameters, pivot_height: float, pose: HopperPose) -> Array:
    """Positions of `JOINTS` in poses, with the boom's pivot at a height [m]; shape (F, 7, 3), or (7, 3) of one pose."""
    beta = np.arcsin(robot.top_length / robot.bottom_length * np.sin(pose.alpha_2))
    outward, forward, up = _tip_axes(pose)

    def link(angle: Array | float, length: float) -> Array:
        return length * (_column(np.sin(angle)) * forward - _column(np.cos(angle)) * up)

    pivot = np.broadcast_to([0.0, 0.0, pivot_height], outward.shape)
    deflection = _column(pose.deflection_forward) * forward + _column(pose.deflection_up) * up
    hip = pivot + robot.boom_length * outward + deflection
    rear_knee = hip + link(pose.alpha_1 - pose.alpha_2, robot.top_length)
    rear_bottom = link(pose.alpha_1 + beta, 1.0)
    return np.stack(
        [
            np.zeros_like(hip),
            pivot,
            hip,
            hip + link(pose.alpha_1 + pose.alpha_2, robot.top_length),
            rear_knee,
            rear_knee + robot.bottom_length * rear_bottom,
            rear_knee + (robot.bottom_length + robot.foot_length) * rear_bottom,
        ],
        axis=-2,
    )


def _tip_axes(pose: HopperPose) -> tuple[Array, Array, Array]:
    """Unit vectors along the boom, along the circle and perpendicular to both; each of shape (…, 3)."""
    sin_yaw = np.sin(pose.yaw)
    cos_yaw = np.cos(pose.yaw)
    none = np.zeros_like(pose.yaw)
    sin_pitch = _column(np.sin(pose.pitch))
    cos_pitch = _column(np.cos(pose.pitch))
    inward = np.stack([-sin_yaw, cos_yaw, none], axis=-1)
    vertical = np.array([0.0, 0.0, 1.0])
    forward = np.stack([cos_yaw, sin_yaw, none], axis=-1)
    return sin_pitch * vertical - cos_pitch * inward, forward, cos_pitch * vertical + sin_pitch * inward


def _column(values: Array | float) -> Array:
    """Numbers with an axis for x, y and z; shape (…, 1)."""
    return np.asarray(values, float)[..., None]
