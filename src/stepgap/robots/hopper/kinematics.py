"""Positions of the joints of boom and leg: the closed chain of the paper's Fig. 1, in MuJoCo's frame of the twin.

The origin is on the floor below the boom's pivot. z points up; at yaw 0, x points forward, and y from the hip to the
pivot. The boom's tip has axes of its own: `outward` along the boom, `forward` along the circle, and `up` perpendicular
to both, so it is tilted by the pitch of the boom. The leg moves in the plane of `forward` and `up`.
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
is the common joint of the bottom links, and the foot the end of the rear knee's bottom link. `joint_positions` computes
them in this order.
"""

LINKS = (
    Link("base", "pivot", 0.02),
    Link("pivot", "hip", 0.010),
    Link("hip", "front_knee", 0.008, "near"),
    Link("front_knee", "ankle", 0.006, "near"),
    Link("hip", "rear_knee", 0.008, "far"),
    Link("rear_knee", "foot", 0.006, "far"),
)
"""Parts between the joints: their ends, the radius of the drawn cylinder [m], and the side of the leg."""

LEG_SIGNALS: Mapping[str, str] = {
    "leg length": "m",
    "leg angle": "rad",
    "torque of motor 1": "N·m",
    "torque of motor 2": "N·m",
}
"""What is drawn over time: the measured leg from the hip to the ankle, and the torques that were applied."""

TOUCHING_FORCE = 1.0  # Ground force above which the foot is drawn as touching the ground [N]


class HopperPose(NamedTuple):
    """One pose of boom and leg, in numbers, or F poses, in arrays of shape (F,).

    Attributes:
        yaw: Horizontal boom angle [rad].
        pitch: Vertical boom angle, upward positive [rad].
        alpha_1: Leg angle α₁ [rad].
        alpha_2: Half the angle between the top links α₂ [rad].
        deflection_forward: Deflection of an elastic boom's tip along `forward` [m].
        deflection_up: Deflection of an elastic boom's tip along `up` [m].
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
    """

    def __init__(self, robot: RobotParameters, gains: Gains, sensors: HopperSensorModel):
        self._robot = robot
        self._gains = gains
        self._sensors = sensors

    @property
    def scene(self) -> Scene:
        """Boom and leg on their circle."""
        return Scene(
            points=JOINTS, links=LINKS, body="hip", feet=("foot",), height="height", circle=self._robot.boom_length,
            signals=LEG_SIGNALS, foothold="foothold",
        )  # fmt: skip

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
        """Motion in ticks; a measured motion is on level ground, without the deflection of the boom."""
        is_true = "boom_yaw" in ticks.units
        pose = self._true_pose(ticks) if is_true else self._measured_pose(ticks)
        touching = np.asarray(ticks["contact_force"] > TOUCHING_FORCE, float)
        return Motion(
            time=ticks["time"],
            step=ticks["step"],
            positions=joint_positions(self._robot, self._sensors.pivot_height, pose),
            touching=touching[:, None],
            ground=ticks["ground_height"] if is_true else np.zeros(len(ticks)),
            signals=self._signals(ticks),
        )

    def at_section(self, state: Array) -> Array:
        """At the apex, at yaw 0, with the leg in the landing posture."""
        speed, height = state[:2]
        sin_pitch = (height - self._sensors.pivot_height) / self._robot.boom_length
        pitch = asin(np.clip(sin_pitch, -1, 1))  # a height that the boom cannot reach is drawn at its end
        alpha_1 = self._gains.speed_gain * (speed - self._gains.speed_setpoint)  # θ_des = K₁(ẋ − ẋ_des)
        alpha_2 = knee_angle(leg_of(self._robot), self._gains.landing_length)
        return joint_positions(self._robot, self._sensors.pivot_height, HopperPose(0.0, pitch, alpha_1, alpha_2))

    def _signals(self, ticks: TickTable) -> Array:
        """Measured values of `LEG_SIGNALS`; shape (F, 4)."""
        top = self._robot.top_length
        bottom = self._robot.bottom_length
        alpha_1 = ticks["alpha_1"]
        alpha_2 = ticks["alpha_2"]
        # ℓ = ℓ₁ cos α₂ + √(ℓ₂² − ℓ₁² sin² α₂)
        length = top * np.cos(alpha_2) + np.sqrt(bottom**2 - (top * np.sin(alpha_2)) ** 2)
        return np.column_stack([length, alpha_1, ticks["applied_1"], ticks["applied_2"]])

    def _measured_pose(self, ticks: TickTable) -> HopperPose:
        """Poses by the encoders; boom and leg are rigid in them."""
        yaw = ticks["boom_horizontal"] * tau / self._sensors.boom_counts_horizontal
        pitch = ticks["boom_vertical"] * tau / self._sensors.boom_counts_vertical
        return HopperPose(yaw, pitch, ticks["alpha_1"], ticks["alpha_2"])

    def _true_pose(self, ticks: TickTable) -> HopperPose:
        """Poses of the twin; where the hip is not at the end of a rigid boom, the boom is deflected by the rest.

        The distance that the hip has travelled is R · yaw + deflection_forward, and its height that of the pivot +
        R sin(pitch) + deflection_up · cos(pitch).
        """
        yaw = ticks["boom_yaw"]
        pitch = ticks["boom_pitch"]
        radius = self._sensors.boom_length
        rigid_height = self._sensors.pivot_height + radius * np.sin(pitch)
        return HopperPose(
            yaw=yaw, pitch=pitch, alpha_1=ticks["true_alpha_1"], alpha_2=ticks["true_alpha_2"],
            deflection_forward=ticks["hip_x"] - radius * yaw,
            deflection_up=(ticks["hip_height"] - rigid_height) / np.cos(pitch),
        )  # fmt: skip


def joint_positions(robot: RobotParameters, pivot_height: float, pose: HopperPose) -> Array:
    """Positions of `JOINTS` in poses [m]; shape (F, 7, 3), or (7, 3) of one pose.

    Args:
        robot: Lengths of the robot.
        pivot_height: Height of the boom's pivot above the floor [m].
    """
    outward, forward, up = _tip_axes(pose)
    beta = np.arcsin(robot.top_length / robot.bottom_length * np.sin(pose.alpha_2))  # sin β = (ℓ₁/ℓ₂) sin α₂
    # The boom from the floor to the hip:
    pivot = np.broadcast_to([0.0, 0.0, pivot_height], outward.shape)
    deflection = _column(pose.deflection_forward) * forward + _column(pose.deflection_up) * up
    hip = pivot + robot.boom_length * outward + deflection
    # The leg from the hip to the foot; the bottom link of the rear knee leans by β against the axis of the leg:
    front_knee = hip + robot.top_length * _link_axis(forward, up, pose.alpha_1 + pose.alpha_2)
    rear_knee = hip + robot.top_length * _link_axis(forward, up, pose.alpha_1 - pose.alpha_2)
    rear_bottom = _link_axis(forward, up, pose.alpha_1 + beta)
    ankle = rear_knee + robot.bottom_length * rear_bottom
    foot = rear_knee + (robot.bottom_length + robot.foot_length) * rear_bottom
    return np.stack([np.zeros_like(hip), pivot, hip, front_knee, rear_knee, ankle, foot], axis=-2)


def _tip_axes(pose: HopperPose) -> tuple[Array, Array, Array]:
    """Unit vectors `outward`, `forward` and `up` of the boom's tip; each of shape (…, 3)."""
    sin_yaw = np.sin(pose.yaw)
    cos_yaw = np.cos(pose.yaw)
    zero = np.zeros_like(pose.yaw)
    sin_pitch = _column(np.sin(pose.pitch))
    cos_pitch = _column(np.cos(pose.pitch))
    vertical = np.array([0.0, 0.0, 1.0])
    inward = np.stack([-sin_yaw, cos_yaw, zero], axis=-1)  # horizontal, from the hip to the pivot
    outward = sin_pitch * vertical - cos_pitch * inward
    forward = np.stack([cos_yaw, sin_yaw, zero], axis=-1)
    up = cos_pitch * vertical + sin_pitch * inward
    return outward, forward, up


def _link_axis(forward: Array, up: Array, angle: Array | float) -> Array:
    """Unit vector along a link at an angle from straight down, forward positive [rad]; shape (…, 3)."""
    return _column(np.sin(angle)) * forward - _column(np.cos(angle)) * up


def _column(values: Array | float) -> Array:
    """Numbers with an axis for x, y and z; shape (…, 1)."""
    return np.asarray(values, float)[..., None]
