"""The robot's motion in one hop, from any kind of record."""

from dataclasses import dataclass
from math import asin, tau

import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.robots.hopper.leg import knee_angle, leg_of
from stepgap.robots.hopper.parameters import Gains, RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.step import Array
from stepgap.view.geometry import HopperPose

TICK_STRIDE = 8
"""Interval of drawn poses, in ticks."""

STILL = 0.75
"""Displayed duration of a hop with unknown motion [s], about that of a real hop."""


@dataclass(frozen=True, eq=False)
class HopMotion:
    """The motion from just after an apex to just after the next one.

    Attributes:
        time: Increasing times since the start of the hop; shape (k,) [s].
        poses: One pose per row, in the order of `HopperPose`; shape (k, 6).
        ground: Height of the ground under the foot; shape (k,) [m].
    """

    time: Array
    poses: Array
    ground: Array

    @property
    def duration(self) -> float:
        """Duration of the hop [s]."""
        return float(self.time[-1])

    def at(self, share: float) -> tuple[HopperPose, float]:
        """Pose, and height of the ground [m], after a fraction (0…1) of the duration."""
        row = min(int(np.searchsorted(self.time, share * self.duration)), len(self.time) - 1)
        return HopperPose(*self.poses[row].tolist()), float(self.ground[row])


def true_hop(table: TickTable, sensors: HopperSensorModel) -> HopMotion | None:
    """True motion of a hop of the twin, simulated again; None without a tick."""
    if not len(table):
        return None
    yaw, pitch = table["boom_yaw"], table["boom_pitch"]
    radius = sensors.boom_length
    along = table["hip_x"] - radius * yaw
    across = (table["hip_height"] - sensors.pivot_height - radius * np.sin(pitch)) / np.cos(pitch)
    poses = np.column_stack([yaw, pitch, table["true_alpha_1"], table["true_alpha_2"], along, across])
    return HopMotion(table["time"] - table["time"][0], poses, table["ground_height"])


def sensed_hop(table: TickTable, sensors: HopperSensorModel) -> HopMotion | None:
    """Measured motion of a hop, on level ground; None without a tick whose sensors were read."""
    table = TickTable(table.units, table.rows[np.isfinite(table.rows).all(axis=1)])
    if not len(table):
        return None
    yaw = table["boom_horizontal"] * tau / sensors.boom_counts_horizontal
    pitch = table["boom_vertical"] * tau / sensors.boom_counts_vertical
    none = np.zeros(len(table))
    poses = np.column_stack([yaw, pitch, table["alpha_1"], table["alpha_2"], none, none])
    return HopMotion(table["time"] - table["time"][0], poses, none)


def still_hop(robot: RobotParameters, gains: Gains, pivot_height: float, state: Array) -> HopMotion:
    """Motion of a hop of which only the apex is known: the robot rests there with its leg in the landing posture."""
    speed, height = state
    pitch = asin(np.clip((height - pivot_height) / robot.boom_length, -1, 1))
    alpha_1 = gains.speed_gain * (speed - gains.speed_setpoint)
    alpha_2 = knee_angle(leg_of(robot), gains.landing_length)
    pose = [0.0, pitch, alpha_1, alpha_2, 0.0, 0.0]
    return HopMotion(np.array([0.0, STILL]), np.array([pose, pose]), np.zeros(2))


def invisible_hop() -> HopMotion:
    """A pause for a step of a robot that is not drawn."""
    return HopMotion(np.array([0.0, STILL]), np.zeros((2, 6)), np.zeros(2))
