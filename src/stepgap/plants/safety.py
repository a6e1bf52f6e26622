"""What may be written to the motors: one pure function between the controller and every rig.

This is software: it cannot help when the computer hangs. What must stop a motor then is the drives' watchdog, and for
people's safety a contactor or the drives' STO input.
"""

from enum import IntFlag
from math import isfinite
from typing import NamedTuple

from stepgap.rigs.rig import HEALTHY, Health
from stepgap.robots.hopper.limits import SafetyLimits


class Limited(IntFlag):
    """Why a torque was not written as asked."""

    NOTHING = 0
    NOT_FINITE = 1
    TORQUE = 2
    JOINT_SPEED = 4
    STRETCH = 8
    TORQUE_STEP = 16
    JOINT_ANGLE = 32
    LEG_LENGTH = 64
    HIP_HEIGHT = 128
    LOST_FRAMES = 256
    STALE = 512
    LATE = 1024
    EMERGENCY_STOP = 4096

    @property
    def stops(self) -> bool:
        """The deployment must end."""
        return bool(self & ~KEEPS_ON)


KEEPS_ON = Limited.TORQUE | Limited.TORQUE_STEP | Limited.STRETCH
"""What only changes the torques; all else stops."""

BRAKED = Limited.JOINT_ANGLE | Limited.LEG_LENGTH | Limited.HIP_HEIGHT | Limited.LATE
"""Stops at which sensors and drives can still be relied on, so that the motors brake before torque goes off.

A joint that is too fast is not among them: its encoder may have the wrong sign, and braking by it would accelerate.
"""


class Motion(NamedTuple):
    """What the sensors say of the robot.

    Attributes:
        alpha_1: Mean angle of the top links α₁ [rad].
        alpha_2: Half the angle between the top links α₂ [rad].
        rate_1: α̇₁ [rad/s].
        rate_2: α̇₂ [rad/s].
        leg_length: ℓ [m].
        hip_height: y [m].
    """

    alpha_1: float
    alpha_2: float
    rate_1: float
    rate_2: float
    leg_length: float
    hip_height: float


class Watch(NamedTuple):
    """What the check remembers from tick to tick; a new one starts with motors limp.

    Attributes:
        torque_1: Last torque of motor 1 [N·m].
        torque_2: Last torque of motor 2 [N·m].
        lost: Frames lost in a row.
        stale: Stale readings in a row.
        late: Ticks missed in a row.
        stopped: Why the motors brake or are off for good.
        braked: Ticks since then.
    """

    torque_1: float = 0.0
    torque_2: float = 0.0
    lost: int = 0
    stale: int = 0
    late: int = 0
    stopped: Limited = Limited.NOTHING
    braked: int = 0


class Checked(NamedTuple):
    """Torques that may be written [N·m], why they differ from those asked, and the watch for the next tick."""

    torque_1: float
    torque_2: float
    limited: Limited
    watch: Watch


def check_torque(
    limits: SafetyLimits, watch: Watch, motion: Motion, health: Health, torque_1: float, torque_2: float
) -> Checked:
    """Limits the torques. Where something is wrong, and from then on, they brake for a while or are zero.

    Args:
        limits: What is allowed.
        watch: Of the tick before.
        motion: Of this tick.
        health: Of this tick.
        torque_1: Torque asked of motor 1 [N·m].
        torque_2: Torque asked of motor 2 [N·m].
    """
    lost = stale = late = 0
    stopped = watch.stopped
    if health is not HEALTHY:
        lost = watch.lost + 1 if health.frame_lost else 0
        stale = watch.stale + 1 if health.stale else 0
        late = watch.late + health.late if health.late else 0
        stopped |= _unhealthy(limits, health, lost, stale, late)
    if beyond := _out_of_range(limits, motion, torque_1 + torque_2):
        stopped |= beyond
    if stopped:
        after = Watch(0.0, 0.0, lost, stale, late, stopped, watch.braked + 1)
        torque_1, torque_2 = _brake(limits, watch, motion) if brakes(limits, after) else (0.0, 0.0)
        return Checked(torque_1, torque_2, stopped, after._replace(torque_1=torque_1, torque_2=torque_2))

    limited = Limited.NOTHING
    if motion.alpha_2 < limits.stretch_angle and torque_1 < torque_2:
        torque_1 = torque_2 = 0.5 * (torque_1 + torque_2)
        limited |= Limited.STRETCH
    most = limits.torque
    if abs(torque_1) > most or abs(torque_2) > most:
        torque_1, torque_2 = _within(most, torque_1), _within(most, torque_2)
        limited |= Limited.TORQUE
    step = limits.torque_step
    if abs(torque_1 - watch.torque_1) > step or abs(torque_2 - watch.torque_2) > step:
        torque_1, torque_2 = _within(step, torque_1, watch.torque_1), _within(step, torque_2, watch.torque_2)
        limited |= Limited.TORQUE_STEP
    return Checked(torque_1, torque_2, limited, Watch(torque_1, torque_2, lost, stale, late))


def brakes(limits: SafetyLimits, watch: Watch) -> bool:
    """Whether a stopped robot's motors still brake."""
    return bool(watch.stopped) and not watch.stopped & ~BRAKED and watch.braked <= limits.brake_ticks


def _brake(limits: SafetyLimits, watch: Watch, motion: Motion) -> tuple[float, float]:
    """Torques against the motors' turning, within limits [N·m]: what drives a motor on goes at once, a brake grows."""
    speed_1, speed_2 = motion.rate_1 + motion.rate_2, motion.rate_1 - motion.rate_2
    return _brake_motor(limits, watch.torque_1, speed_1), _brake_motor(limits, watch.torque_2, speed_2)


def _brake_motor(limits: SafetyLimits, before: float, speed: float) -> float:
    brake = _within(limits.torque, -limits.brake_damping * speed)
    return _within(abs(brake), _within(limits.torque_step, brake, before if before * brake > 0 else 0.0))


def _within(most: float, value: float, centre: float = 0.0) -> float:
    """The value, or what is nearest to it no farther than `most` from the centre."""
    return min(centre + most, max(centre - most, value))


def _out_of_range(limits: SafetyLimits, motion: Motion, torques: float) -> Limited:
    """Why the motion or the torques, given as their sum, cannot go on."""
    alpha_1, alpha_2, rate_1, rate_2, leg_length, hip_height = motion
    if not isfinite(torques + alpha_1 + alpha_2 + rate_1 + rate_2 + leg_length + hip_height):
        return Limited.NOT_FINITE
    reason = Limited.NOTHING
    if abs(rate_1) + abs(rate_2) > limits.joint_speed:
        reason |= Limited.JOINT_SPEED
    if abs(alpha_1) > limits.lean_angle or alpha_2 > limits.fold_angle:
        reason |= Limited.JOINT_ANGLE
    if not limits.shortest_leg <= leg_length <= limits.longest_leg:
        reason |= Limited.LEG_LENGTH
    if not limits.lowest_hip <= hip_height <= limits.highest_hip:
        reason |= Limited.HIP_HEIGHT
    return reason


def _unhealthy(limits: SafetyLimits, health: Health, lost: int, stale: int, late: int) -> Limited:
    """Why the tick's health, its bad ticks in a row counted, cannot go on."""
    reason = Limited.NOTHING
    if lost > limits.lost_frames:
        reason |= Limited.LOST_FRAMES
    if stale > limits.stale_ticks:
        reason |= Limited.STALE
    if late > limits.late_ticks:
        reason |= Limited.LATE
    if health.emergency_stop:
        reason |= Limited.EMERGENCY_STOP
    return reason
