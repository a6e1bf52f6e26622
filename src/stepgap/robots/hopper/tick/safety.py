"""Safety function: one pure function between the controller and every rig limits the torques.

This is software, which cannot act when the computer hangs. In that case the drives' watchdog must stop the motors; for
the safety of people a contactor or the drives' STO input is needed.
"""

from enum import IntFlag
from math import inf, isfinite
from typing import NamedTuple

from stepgap.base.compiled import as_written


class Limited(IntFlag):
    """Reasons why a torque was not written as requested."""

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
    SPEED_GREW = 2048
    EMERGENCY_STOP = 4096
    MOTOR_1_FROZEN = 1 << 13
    MOTOR_2_FROZEN = 1 << 14
    YAW_AGAINST_LEG = 1 << 15
    PITCH_FROZEN = 1 << 16
    MOTOR_1_JUMPED = 1 << 17
    MOTOR_2_JUMPED = 1 << 18
    YAW_JUMPED = 1 << 19
    PITCH_JUMPED = 1 << 20
    CONTACT_IN_AIR = 1 << 21
    GROUND_WITHOUT_CONTACT = 1 << 22
    FOOT_BELOW_GROUND = 1 << 23
    OVERLOAD = 1 << 24
    POWER = 1 << 25
    YAW_NOISY = 1 << 26
    PITCH_NOISY = 1 << 27
    PITCH_AGAINST_LEG = 1 << 28
    PITCH_AGAINST_FLIGHT = 1 << 29
    MOTOR_1_DISOBEYS = 1 << 30
    MOTOR_2_DISOBEYS = 1 << 31

    @property
    def stops(self) -> bool:
        """Whether the deployment must end."""
        return bool(self & ~CHANGES_TORQUE)


CHANGES_TORQUE = Limited.TORQUE | Limited.TORQUE_STEP | Limited.STRETCH
"""Reasons that only change the torques; all others stop the robot."""

BRAKED = Limited.JOINT_ANGLE | Limited.LEG_LENGTH | Limited.HIP_HEIGHT | Limited.LATE | Limited.OVERLOAD | Limited.POWER
"""Reasons to stop with sensors and drives that are still reliable, so that the motors brake before torque goes off.

A joint that is too fast is not among them: its encoder may have the wrong sign, so that braking would accelerate it.
Nor is a doubtful sensor. Where an angle or a height beyond its limit is itself the first sign of a wrong sensor, the
brake is harmless: its torque is limited, and it is released if the speed grows.
"""

DISOBEYS = Limited.MOTOR_1_DISOBEYS | Limited.MOTOR_2_DISOBEYS
"""Reasons to doubt a drive, which `drive_motion` finds."""

DOUBTS = Limited(sum(reason for reason in Limited if reason >= Limited.MOTOR_1_FROZEN)) & ~(
    Limited.OVERLOAD | Limited.POWER
)
"""Reasons to doubt a sensor or a drive, which `plausibility` and `drive_motion` find."""

BRAKE_GROWTH = 10.0
"""Growth of the joint speed at which motors stop to brake, since the brake accelerates them [rad/s]."""

# Numba does not compile flags, so compiled code uses their numbers.
_NOT_FINITE = int(Limited.NOT_FINITE)
_TORQUE = int(Limited.TORQUE)
_JOINT_SPEED = int(Limited.JOINT_SPEED)
_STRETCH = int(Limited.STRETCH)
_TORQUE_STEP = int(Limited.TORQUE_STEP)
_JOINT_ANGLE = int(Limited.JOINT_ANGLE)
_LEG_LENGTH = int(Limited.LEG_LENGTH)
_HIP_HEIGHT = int(Limited.HIP_HEIGHT)
_LOST_FRAMES = int(Limited.LOST_FRAMES)
_STALE = int(Limited.STALE)
_LATE = int(Limited.LATE)
_EMERGENCY_STOP = int(Limited.EMERGENCY_STOP)
_SPEED_GREW = int(Limited.SPEED_GREW)
_BRAKED = int(BRAKED)
STOPS = int(Limited(sum(Limited)) & ~CHANGES_TORQUE)  # Bits of all reasons that stop the robot


class JointMotion(NamedTuple):
    """Measured motion of leg and hip.

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
    """State of the safety function; a new one starts with limp motors.

    Attributes:
        torque_1: Last torque of motor 1 [N·m].
        torque_2: Last torque of motor 2 [N·m].
        lost: Number of frames lost in a row.
        stale: Number of stale readings in a row.
        late: Number of ticks missed in a row.
        stopped: Reasons why the motors brake or stay off; the number of a `Limited`.
        braked: Number of ticks since the stop.
        slowest: Smallest joint speed since the stop [rad/s].
    """

    torque_1: float = 0.0
    torque_2: float = 0.0
    lost: int = 0
    stale: int = 0
    late: int = 0
    stopped: int = 0
    braked: int = 0
    slowest: float = inf


class Checked(NamedTuple):
    """Torques that may be written [N·m], why they differ from the requested ones, and the watch for the next tick.

    The reason is the number of a `Limited`.
    """

    torque_1: float
    torque_2: float
    limited: int
    watch: Watch


@as_written
def check_torque(limits, stage, watch, motion, health, doubts, torque_1, torque_2):
    """Limits the torques; after a fault they brake for a while and then stay zero.

    Args:
        limits: Limits; fields as in `SafetyLimits`.
        stage: Limits of torque and speed at this tick; fields as in `Stage`.
        watch: Watch of the previous tick; fields as in `Watch`.
        motion: JointMotion at this tick; fields as in `JointMotion`.
        health: Health at this tick; fields as in `Health`.
        doubts: Reasons to doubt a sensor or a drive at this tick, and an overload, as the number of a `Limited`.
        torque_1: Torque requested of motor 1 [N·m].
        torque_2: Torque requested of motor 2 [N·m].

    Returns:
        `Checked`.
    """
    lost = watch.lost + 1 if health.frame_lost else 0
    stale = watch.stale + 1 if health.stale else 0
    late = watch.late + health.late if health.late else 0
    stopped = watch.stopped | doubts | _unhealthy(limits, health.emergency_stop, lost, stale, late)
    stopped |= _out_of_range(limits, stage.joint_speed, motion, torque_1 + torque_2)
    if stopped:
        braked = watch.braked + 1
        speed = abs(motion.rate_1) + abs(motion.rate_2)
        slowest = min(watch.slowest, speed)
        if speed > slowest + BRAKE_GROWTH:
            stopped |= _SPEED_GREW
        torque_1 = torque_2 = 0.0
        if brakes(limits, stopped, braked):
            torque_1 = _brake(limits, watch.torque_1, motion.rate_1 + motion.rate_2)
            torque_2 = _brake(limits, watch.torque_2, motion.rate_1 - motion.rate_2)
        after = Watch(
            torque_1=torque_1, torque_2=torque_2, lost=lost, stale=stale, late=late, stopped=stopped, braked=braked,
            slowest=slowest,
        )  # fmt: skip
        return Checked(torque_1, torque_2, stopped, after)
    torque_1, torque_2, limited = _within_limits(limits, stage.torque, watch, motion.alpha_2, torque_1, torque_2)
    after = Watch(
        torque_1=torque_1, torque_2=torque_2, lost=lost, stale=stale, late=late, stopped=0, braked=0, slowest=inf
    )
    return Checked(torque_1, torque_2, limited, after)


@as_written
def brakes(limits, stopped, braked):
    """Whether the motors of a robot still brake that was stopped for these reasons so many ticks ago."""
    return stopped != 0 and stopped & ~_BRAKED == 0 and braked <= limits.brake_ticks


@as_written
def _brake(limits, before, speed):
    """Torque against a motor's rotation, within limits [N·m]; driving torque ends immediately, braking torque grows."""
    brake = _within(min(limits.torque, limits.brake_torque), -limits.brake_damping * speed, 0.0)
    start = before if before * brake > 0 else 0.0
    return _within(abs(brake), _within(limits.torque_step, brake, start), 0.0)


@as_written
def _within_limits(limits, most, watch, alpha_2, torque_1, torque_2):
    """Returns the torques within limits [N·m], and why they differ from the requested ones."""
    limited = 0
    step = limits.torque_step
    if alpha_2 < limits.stretch_angle and torque_1 < torque_2:
        torque_1 = torque_2 = 0.5 * (torque_1 + torque_2)
        limited |= _STRETCH
    if abs(torque_1) > most or abs(torque_2) > most:
        torque_1 = _within(most, torque_1, 0.0)
        torque_2 = _within(most, torque_2, 0.0)
        limited |= _TORQUE
    if abs(torque_1 - watch.torque_1) > step or abs(torque_2 - watch.torque_2) > step:
        torque_1 = _within(step, torque_1, watch.torque_1)
        torque_2 = _within(step, torque_2, watch.torque_2)
        limited |= _TORQUE_STEP
    return torque_1, torque_2, limited


@as_written
def _within(most, value, centre):
    """The value, limited to a distance of `most` from the centre."""
    return min(centre + most, max(centre - most, value))


@as_written
def _out_of_range(limits, joint_speed, motion, torques):
    """Reasons why the motion or the torques, given as their sum, are not allowed."""
    angles = motion.alpha_1 + motion.alpha_2
    rates = motion.rate_1 + motion.rate_2
    if not isfinite(torques + angles + rates + motion.leg_length + motion.hip_height):
        return _NOT_FINITE
    reason = 0
    if abs(motion.rate_1) + abs(motion.rate_2) > joint_speed:
        reason |= _JOINT_SPEED
    if abs(motion.alpha_1) > limits.lean_angle or motion.alpha_2 > limits.fold_angle:
        reason |= _JOINT_ANGLE
    if not limits.shortest_leg <= motion.leg_length <= limits.longest_leg:
        reason |= _LEG_LENGTH
    if not limits.lowest_hip <= motion.hip_height <= limits.highest_hip:
        reason |= _HIP_HEIGHT
    return reason


@as_written
def _unhealthy(limits, emergency_stop, lost, stale, late):
    """Reasons why the health, given by its numbers of bad ticks in a row, is not allowed."""
    reason = 0
    if lost > limits.lost_frames:
        reason |= _LOST_FRAMES
    if stale > limits.stale_ticks:
        reason |= _STALE
    if late > limits.late_ticks:
        reason |= _LATE
    if emergency_stop:
        reason |= _EMERGENCY_STOP
    return reason
