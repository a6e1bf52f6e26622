"""What may be written to the motors: one pure function between the controller and every rig."""

from dataclasses import dataclass
from enum import IntFlag
from math import isfinite
from typing import NamedTuple

from stepgap.hopper.parameters import RobotParameters


class Limited(IntFlag):
    """Why a torque was not written as asked."""

    NOTHING = 0
    NOT_FINITE = 1
    TORQUE = 2
    JOINT_SPEED = 4
    STRETCH = 8

    @property
    def stops(self) -> bool:
        """The deployment must end."""
        return bool(self & (Limited.NOT_FINITE | Limited.JOINT_SPEED))


@dataclass(frozen=True)
class SafetyLimits:
    """What the joints may do.

    Attributes:
        torque: Largest motor torque [N·m].
        joint_speed: Largest speed of a top link [rad/s]; a hop of the reference stays below 40.
        stretch_angle: α₂ below which the leg may not be stretched further [rad].
    """

    torque: float
    joint_speed: float = 120.0
    stretch_angle: float = 0.1

    @classmethod
    def of(cls, robot: RobotParameters) -> "SafetyLimits":
        """The limits of a robot."""
        return cls(torque=robot.torque_limit)


class Checked(NamedTuple):
    """Torques that may be written [N·m], and why they differ from those asked."""

    torque_1: float
    torque_2: float
    limited: Limited


def check_torque(
    limits: SafetyLimits, torque_1: float, torque_2: float, alpha_2: float, rate_1: float, rate_2: float
) -> Checked:
    """Limits the torques; zero where something is wrong.

    Args:
        limits: What is allowed.
        torque_1: Torque asked of motor 1 [N·m].
        torque_2: Torque asked of motor 2 [N·m].
        alpha_2: Half the angle between the top links [rad].
        rate_1: α̇₁ [rad/s].
        rate_2: α̇₂ [rad/s].
    """
    if not isfinite(torque_1 + torque_2 + alpha_2 + rate_1 + rate_2):
        return Checked(0.0, 0.0, Limited.NOT_FINITE)
    if abs(rate_1) + abs(rate_2) > limits.joint_speed:
        return Checked(0.0, 0.0, Limited.JOINT_SPEED)
    limited = Limited.NOTHING
    if alpha_2 < limits.stretch_angle and torque_1 < torque_2:
        torque_1 = torque_2 = 0.5 * (torque_1 + torque_2)
        limited |= Limited.STRETCH
    if abs(torque_1) > limits.torque or abs(torque_2) > limits.torque:
        torque_1 = min(limits.torque, max(-limits.torque, torque_1))
        torque_2 = min(limits.torque, max(-limits.torque, torque_2))
        limited |= Limited.TORQUE
    return Checked(torque_1, torque_2, limited)
