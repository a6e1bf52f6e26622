"""Plausibility of the hopper's sensors: each is judged by its own last readings, by the torques, and by the others.

All checks are pure and compiled. A doubt stops the robot like a limit (`safety`), but torque goes off at once, since a
brake would rely on the doubtful sensor. The thresholds follow from the resolution of the sensors and the motion of the
robot; those that depend on the robot are in `SafetyLimits`. The largest values of 14 twins of the family, 700 hops with
random commands, are given beside them.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.plants.tick_control import Mode
from stepgap.robots.hopper.tick.closures import FOOT_SHARE, Closures, judge_closures
from stepgap.robots.hopper.tick.encoder_track import (
    JITTER_SHARE,
    NO_JUMP,
    STILL_COUNTS,
    Counts,
    EncoderTrack,
    is_noisy,
    may_rest,
    with_angle,
    with_count,
)
from stepgap.robots.hopper.tick.estimator import vertical_acceleration
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited

_TURN = 2.0 * np.pi

MOST_SHARED = 10.0
"""Largest jump of a motor that the opposite jump of the other explains, as a multiple of the smallest detected jump.

Impacts and vibrations fold the leg, so both links move by the same angle in opposite directions: on 45 twins below
80 rad/s, up to 0.035 rad per tick, but at most 0.0008 rad more than the other. An encoder that fails jumps alone.
"""

CHANGE = 10.0
"""Change of the movement in a tick, as a multiple of the smallest detected jump, which no torque or impact causes.

The largest change, also of links that stop, was 0.025 rad. So a jump of 2.3° and more of a link at rest is detected by
the reading that contains it.
"""

JITTER_CHANGE = 2.0
"""Largest change that is seen where a reading is taken a tick too late, in movements per tick; see `JITTER_SHARE`."""

LIGHT_LINK = 8e-4
"""Smallest inertia of a top link with its part of the bottom link [kg·m²]: how far a change of torque moves it.

With lost frames, links of some twins vibrate by more than 0.004 rad from tick to tick.
"""

JUMP_COUNTS = 4.0
ROUNDING = 2.0
"""Least jump that is detected, and that which rounding alone causes [counts]. Noise is detected as jumps, too."""

HIP_ACCELERATION = 1000.0
"""Acceleration of the hip that lasts a tick and is no jump of the boom [m/s²]: a boom that carries the robot does not
vibrate as links do. At 1 ms that is 1.4 counts of the pitch, so that `JUMP_COUNTS` decide (1.5)."""

MOVING_TORQUE = 0.5
"""Torque that moves a link [N·m]: more than friction and gravity, less than 2 % of the largest."""

PITCH_STILL = 7.0
"""Time for which the pitch may stand still in flight, as a multiple of `frozen_time` (68 ms, around an apex)."""

NO_CONTACT = 6.0
"""Time for which a foot at the ground may have no contact force, as a multiple of `frozen_time` (43 ms)."""

FREE_FALL = -2.0
"""Acceleration of the hip below which the robot flies, however low [m/s²]; the boom halves the gravity."""

SWEEP = 0.012
UNEVEN_SWEEP = 0.03
"""Travel of the hip over a resting foot in which the yaw must move [m]; a foot that slips moves the hip, too (5 mm). On
measured ground, where a foot slips down a slope under a hip that rests, it must in the second one (20 mm)."""

_FROZEN = int(Limited.MOTOR_1_FROZEN)
_JUMPED = int(Limited.MOTOR_1_JUMPED)
_YAW_AGAINST_LEG = int(Limited.YAW_AGAINST_LEG)
_YAW_NOISY = int(Limited.YAW_NOISY)
_PITCH_NOISY = int(Limited.PITCH_NOISY)
_CONTACT_IN_AIR, _GROUND_WITHOUT_CONTACT, _FOOT_BELOW_GROUND = (
    int(reason) for reason in (Limited.CONTACT_IN_AIR, Limited.GROUND_WITHOUT_CONTACT, Limited.FOOT_BELOW_GROUND)
)


class SensorWatch(NamedTuple):
    """State of the plausibility checks.

    Attributes:
        motor_1, motor_2, yaw, pitch: Last readings of the encoders.
        contact: Whether the contact force was above its threshold.
        yaw_there: Yaw at touchdown [rad]; NaN after it has moved in this stance, and in flight.
        foot_there: Forward distance of the foot from the hip at touchdown [m].
        low: Time for which the foot has been at the ground without contact force [s].
        yaw_counts, pitch_counts: Counts of the boom's encoders.
        closures: Yaw and pitch compared with the leg and the flight.
    """

    motor_1: EncoderTrack = EncoderTrack()
    motor_2: EncoderTrack = EncoderTrack()
    yaw: EncoderTrack = EncoderTrack()
    pitch: EncoderTrack = EncoderTrack()
    contact: int = 0
    yaw_there: float = np.nan
    foot_there: float = 0.0
    low: float = 0.0
    yaw_counts: Counts = Counts()
    pitch_counts: Counts = Counts()
    closures: Closures = Closures()


@as_written
def judge_sensors(settings, state, sampled, phase, motion, body, flight, inputs):
    """Returns `SensorWatch` after this tick, and the reasons to doubt a sensor, as the number of a `Limited`.

    Args:
        settings: `TickSettings`.
        state: `HopState` after the tick before.
        sampled: Time of the reading [s].
        phase: Number of the phase of this tick.
        motion: `JointMotion` of this tick.
        body: `Body` of this tick.
        flight: `FlightState` of this tick.
        inputs: `TickInputs`.
    """
    contact = int(inputs.contact_force > settings.sensor_model.touchdown_force)
    motor_1, motor_2, yaw, pitch, yaw_counts, pitch_counts, doubts = _judge_encoders(
        settings, state, sampled, contact, phase, body, inputs
    )
    yaw_there, foot_there, slid = _judge_stance(settings, state, contact, phase, body)
    height = motion.hip_height + body.foot_y
    low = 0.0
    misplaced = 0
    if settings.uneven:  # above the ground of the stance before; until the first take-off none is known
        height = height - state.landing.ground if state.flight.start > 0.0 else 0.0
    if not settings.uneven or state.flight.start > 0.0:
        low, misplaced = _judge_foot(settings, state, sampled, contact, phase, height)
    force = inputs.contact_force if contact and _is_stance(phase) else 0.0
    closures, unclosed = judge_closures(settings, state, flight, sampled, force, phase, height, body)
    if inputs.mode == Mode.STEP:
        doubts |= slid | misplaced
        if settings.limits.frozen_time < np.inf:
            doubts |= unclosed
    return SensorWatch(
        motor_1=motor_1, motor_2=motor_2, yaw=yaw, pitch=pitch, contact=contact, yaw_there=yaw_there,
        foot_there=foot_there, low=low, yaw_counts=yaw_counts, pitch_counts=pitch_counts, closures=closures,
    ), doubts  # fmt: skip


@as_written
def _judge_encoders(settings, state, sampled, contact, phase, body, inputs):
    """Tracks of the four encoders, counts of yaw and pitch, and the reasons to doubt one of them."""
    watch = state.sensors
    model = settings.sensor_model
    limits = settings.limits
    tick = model.tick
    motor = _TURN / model.motor_counts
    yaw_count = _TURN / model.boom_counts_horizontal
    pitch_count = _TURN / model.boom_counts_vertical
    pulled = inputs.mode == Mode.STEP or inputs.mode == Mode.POSTURE
    moves_1 = pulled and abs(inputs.applied_1) > MOVING_TORQUE
    moves_2 = pulled and abs(inputs.applied_2) > MOVING_TORQUE
    flies = inputs.mode == Mode.STEP and _in_flight(state, phase)
    motor_1, jump_1 = with_angle(watch.motor_1, tick, motor, sampled, motor * inputs.motor_1, inputs.applied_1, moves_1)
    motor_2, jump_2 = with_angle(watch.motor_2, tick, motor, sampled, motor * inputs.motor_2, inputs.applied_2, moves_2)
    yaw, jump_3 = with_angle(watch.yaw, tick, yaw_count, sampled, body.yaw, 0.0, False)
    pitch, jump_4 = with_angle(watch.pitch, tick, pitch_count, sampled, pitch_count * inputs.boom_vertical, 0.0, flies)
    if contact:
        pitch = may_rest(pitch)
    link = limits.jump_angle
    boom = HIP_ACCELERATION * tick * tick / model.boom_length if link < np.inf else link
    doubts = _doubts(limits, link, motor_1, jump_1, jump_2, tick, motor, limits.frozen_time)
    doubts |= _doubts(limits, link, motor_2, jump_2, jump_1, tick, motor, limits.frozen_time) << 1
    doubts |= _doubts(limits, boom, yaw, jump_3, NO_JUMP, tick, yaw_count, limits.frozen_time) << 2
    doubts |= _doubts(limits, boom, pitch, jump_4, NO_JUMP, tick, pitch_count, PITCH_STILL * limits.frozen_time) << 3
    yaw_counts = watch.yaw_counts
    pitch_counts = watch.pitch_counts
    if sampled > state.sampled:
        yaw_counts = with_count(yaw_counts, tick, yaw_count, inputs.boom_horizontal, yaw, jump_3)
        pitch_counts = with_count(pitch_counts, tick, pitch_count, inputs.boom_vertical, pitch, jump_4)
    if limits.jump_angle < np.inf:
        doubts |= _YAW_NOISY if is_noisy(yaw_counts, limits.sample_jitter) else 0
        doubts |= _PITCH_NOISY if is_noisy(pitch_counts, limits.sample_jitter) else 0
    return motor_1, motor_2, yaw, pitch, yaw_counts, pitch_counts, doubts


@as_written
def _doubts(limits, angle, track, jump, other, tick, count, longest_still):
    """Reasons to doubt an encoder, as those of motor 1; the other arguments are as for `jump_ratio`."""
    doubts = _FROZEN if track.still > longest_still else 0
    return doubts | _JUMPED if jump_ratio(limits, angle, jump, other, tick, count) > 1.0 else doubts


@as_written
def jump_ratio(limits, angle, jump, other, tick, count):
    """Jump of an encoder as a multiple of the largest one for which it is not doubted.

    Args:
        limits: `SafetyLimits`.
        angle: Smallest jump for which it is doubted [rad]; `JUMP_COUNTS` if that is more.
        jump: `Jump` of the encoder.
        other: `Jump` of the other motor; `NO_JUMP` for an encoder of the boom.
        tick: Time of a tick [s].
        count: Angle of a count [rad].
    """
    least = max(angle, JUMP_COUNTS * count)
    jitter = limits.sample_jitter
    shared = MOST_SHARED * least
    rounding = ROUNDING * count
    size = _alone(jump.size, other.size, shared, rounding)
    change = _alone(jump.change, other.change, shared, rounding)
    most = least + JITTER_SHARE * jitter * jump.speed + tick * tick / LIGHT_LINK * jump.restless
    return max(size / most, change / (CHANGE * least + JITTER_CHANGE * jitter * jump.pace))


@as_written
def _alone(jump, other, most, rounding):
    """Part of a jump that no opposite jump of the other motor explains [rad]."""
    return abs(jump) - (min(most, max(0.0, abs(other) - rounding)) if jump * other < 0.0 else 0.0)


@as_written
def _judge_stance(settings, state, contact, phase, body):
    """Yaw and forward distance of the foot at touchdown, and the reason to doubt a yaw that does not move with the hip.

    On level ground, a foot that slips under a hip at rest would need a leg that pushes the ground but not the body. A
    foot that bounces moves freely, so each contact is judged on its own.
    """
    yaw_there = state.sensors.yaw_there
    foot_there = state.sensors.foot_there
    if not (contact and _is_stance(phase)):
        return np.nan, foot_there, 0
    if not (state.sensors.contact and _is_stance(state.phase)):
        return body.yaw, body.foot_x, 0
    if abs(body.yaw - yaw_there) > STILL_COUNTS * _TURN / settings.sensor_model.boom_counts_horizontal:
        return np.nan, foot_there, 0
    most = UNEVEN_SWEEP if settings.uneven else SWEEP
    swept = not np.isnan(yaw_there) and abs(body.foot_x - foot_there) > most
    return yaw_there, foot_there, _YAW_AGAINST_LEG if swept and settings.limits.frozen_time < np.inf else 0


@as_written
def _judge_foot(settings, state, sampled, contact, phase, height):
    """Time for which a foot at the ground has had no contact force [s]; reasons why leg, height and force contradict.

    Takes the height of the foot [m], which follows from the leg and the pitch of the boom. On uneven ground a foot may
    be low because the ground is.
    """
    limits = settings.limits
    low = height < FOOT_SHARE * limits.ground_height and not settings.uneven
    without = not contact and _in_flight(state, phase) and low
    low = state.sensors.low + (sampled - state.sampled) if without else 0.0
    doubts = 0
    if low > NO_CONTACT * limits.frozen_time and not _rises(state, phase):
        doubts |= _GROUND_WITHOUT_CONTACT
    if height > limits.ground_height and contact:
        doubts |= _CONTACT_IN_AIR
    if height < -limits.ground_height:
        doubts |= _FOOT_BELOW_GROUND
    return low, doubts


@as_written
def _rises(state, phase):
    """Whether the robot rises without a push from the ground, which a low hop does as well as a high one."""
    return phase == Phase.ASCENT and vertical_acceleration(state.flight.fit) < FREE_FALL


@as_written
def _is_stance(phase):
    return phase == Phase.COMPRESSION or phase == Phase.THRUST


@as_written
def _in_flight(state, phase):
    """Whether the robot flies by itself: not before the first take-off, until which a person may hold it."""
    return state.flight.start > 0.0 and not _is_stance(phase)
