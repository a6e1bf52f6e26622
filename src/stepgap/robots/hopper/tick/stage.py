"""Limits that depend on the stage of a deployment: small until the robot has shown that it hops.

While the robot takes its posture, nothing but gravity and friction resists the motors. A motor with a wrong sign or a
wrong zero shows there, so that a small torque and a small speed suffice. The limits of the first hops are a part of the
full ones, and grow with each hop that reaches its apex. In the landing, the torque decreases to that of the posture.
"""

from typing import NamedTuple

from stepgap.base.compiled import as_written
from stepgap.plants.tick_control import Mode


class Stage(NamedTuple):
    """Limits of the present stage.

    Attributes:
        torque: Largest motor torque [N·m].
        joint_speed: Largest speed of a top link [rad/s].
    """

    torque: float
    joint_speed: float


@as_written
def stage_of(limits, mode, share, hops):
    """`Stage` of a tick.

    Args:
        limits: `SafetyLimits`.
        mode: Number of the `Mode`.
        share: Fraction of the landing time that has passed, in LAND.
        hops: Number of hops that have reached their apex in this deployment.
    """
    if mode == Mode.POSTURE:
        return Stage(min(limits.torque, limits.posture_torque), min(limits.joint_speed, limits.posture_speed))
    factor = 1.0
    if hops < limits.first_hops:
        factor = limits.first_share + (1.0 - limits.first_share) * hops / limits.first_hops
    torque = factor * limits.torque
    joint_speed = factor * limits.joint_speed
    if mode == Mode.LAND and limits.posture_torque < torque:
        torque = max(limits.posture_torque, (1.0 - share) * torque)
    return Stage(torque, joint_speed)
