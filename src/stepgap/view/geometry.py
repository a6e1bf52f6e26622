"""Positions of the joints of boom and leg: the closed chain of Fig. 1 in MuJoCo's frame of the twin.

x points forward at yaw 0, y to the boom's pivot side, z up from the floor; the pivot stands over the origin. The leg
swings in the plane of the boom's tip: `forward` along the circle, `up` perpendicular to the boom, tilted by its pitch.
"""

from dataclasses import dataclass
from math import sqrt
from typing import NamedTuple

import numpy as np

from stepgap.robots.hopper.leg import four_bar, leg_of
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.step import Array


class HopperPose(NamedTuple):
    """Pose of boom and leg.

    Attributes:
        yaw: Horizontal boom angle [rad].
        pitch: Vertical boom angle, upward positive [rad].
        alpha_1: Leg angle α₁ [rad].
        alpha_2: Half the angle between the top links α₂ [rad].
        deflection_forward: Forward deflection of an elastic boom's tip [m].
        deflection_up: Upward deflection of an elastic boom's tip [m].
    """

    yaw: float
    pitch: float
    alpha_1: float
    alpha_2: float
    deflection_forward: float = 0.0
    deflection_up: float = 0.0


@dataclass(frozen=True, eq=False)
class Joints:
    """Positions of the joints, each of shape (3,) [m].

    Attributes:
        pivot: Pivot of the boom.
        hip: Hip at the boom's tip.
        front_knee: Knee of the link that motor 1 drives, at α₁ + α₂.
        rear_knee: Knee of the link that motor 2 drives, at α₁ − α₂.
        ankle: Common joint of the bottom links.
        foot: End of the rear knee's bottom link.
    """

    pivot: Array
    hip: Array
    front_knee: Array
    rear_knee: Array
    ankle: Array
    foot: Array

    @property
    def links(self) -> dict[str, tuple[Array, Array]]:
        """Ends of the rigid parts by their names."""
        return {
            "boom": (self.pivot, self.hip),
            "front_top": (self.hip, self.front_knee),
            "rear_top": (self.hip, self.rear_knee),
            "front_bottom": (self.front_knee, self.ankle),
            "rear_bottom": (self.rear_knee, self.foot),
        }


def joints_at(robot: RobotParameters, pivot_height: float, pose: HopperPose) -> Joints:
    """Positions of the joints in a pose, with the boom's pivot at a height [m]."""
    bar = four_bar(leg_of(robot), pose.alpha_2)
    beta = np.arctan2(bar.sin_beta, bar.cos_beta)
    outward, forward, up = _tip_axes(pose)

    def link(angle: float, length: float) -> Array:
        return length * (np.sin(angle) * forward - np.cos(angle) * up)

    pivot = np.array([0.0, 0.0, pivot_height])
    deflection = pose.deflection_forward * forward + pose.deflection_up * up
    hip = pivot + robot.boom_length * outward + deflection
    front_knee = hip + link(pose.alpha_1 + pose.alpha_2, robot.top_length)
    rear_knee = hip + link(pose.alpha_1 - pose.alpha_2, robot.top_length)
    rear_bottom = link(pose.alpha_1 + beta, 1.0)
    return Joints(
        pivot,
        hip,
        front_knee,
        rear_knee,
        rear_knee + robot.bottom_length * rear_bottom,
        rear_knee + (robot.bottom_length + robot.foot_length) * rear_bottom,
    )


def _tip_axes(pose: HopperPose) -> tuple[Array, Array, Array]:
    """Unit vectors along the boom, along the circle and perpendicular to both."""
    sin_yaw, cos_yaw = np.sin(pose.yaw), np.cos(pose.yaw)
    inward = np.array([-sin_yaw, cos_yaw, 0.0])
    vertical = np.array([0.0, 0.0, 1.0])
    outward = np.sin(pose.pitch) * vertical - np.cos(pose.pitch) * inward
    up = np.cos(pose.pitch) * vertical + np.sin(pose.pitch) * inward
    return outward, np.array([cos_yaw, sin_yaw, 0.0]), up


def turned_to(direction: Array) -> Array:
    """Quaternion (w, x, y, z) of the shortest rotation from +z to a direction; shape (4,)."""
    x, y, z = direction / np.linalg.norm(direction)
    if z < -1 + 1e-12:
        return np.array([0.0, 1.0, 0.0, 0.0])
    scale = sqrt(2 * (1 + z))
    return np.array([scale / 2, -y / scale, x / scale, 0.0])
