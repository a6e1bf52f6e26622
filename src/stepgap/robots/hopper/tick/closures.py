"""Closures: what yaw and pitch say of a hop, compared in size with the leg and the laws of flight; compiled.

In stance the foot is at rest, so the hip travels as far by the yaw as the leg swings over the foot: the *slip*, the
speed of the foot by both, is zero. At touchdown the foot is on the ground, by leg and pitch. In flight the hip falls
with the same acceleration as in the flights before, and the apex is found just after the vertex of the parabola.

A closure of one hop shows a large fault only, since the yaw is rounded and a foot slips. So evidence of a small fault
is collected over stances, as a sequential test does: for a drift of the yaw in either direction, and for too many or
too few counts in proportion to the travel. Each sum is a logarithm of likelihoods and is never negative.

The largest values of 21 healthy twins of the family, 227 hops each, are given beside the thresholds.
"""

from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.robots.hopper.tick.estimator import after_vertex, vertical_acceleration
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited

LEAST_STANCE = 0.06
"""Duration of a contact from which its slip is known well enough [s]; those of hops take 0.09 to 0.17 s."""

MOST_SLIP, MOST_SLIP_SHARE = 0.2, 0.1
"""Largest slip of one stance [m/s], and in addition as a part of the speed of the leg (0.16 at 0.6 m/s)."""

COUNTED_SLIP, COUNTED_SHARE = 0.03, 0.05
"""Largest slip that counts as evidence [m/s], and in addition as a part of that speed, since a foot does slip once."""

SLIP_DEVIATION = 0.007
"""Least standard deviation of the slip [m/s]; what is more on a robot whose foot slips often is measured."""

DRIFT, DRIFT_SHARE = 0.008, 0.03
"""Mean slip that is no evidence of a drift [m/s], and in addition as a part of the speed of the leg."""

WRONG_SCALE, ALLOWED_FEW, ALLOWED_MANY = 0.1, 0.07, 0.04
"""Error of scale for which evidence is collected, and allowed ones: a foot that slips backward seems to be too few
counts for the swing of the leg."""

MOST_EVIDENCE = 8.0  # Evidence from which the yaw is doubted (4.6)
MEAN_GAIN = 0.2  # Weight of the latest hop in slow means

FOOT_SHARE = 0.5
"""Largest slow mean of the height of the foot at touchdown above or below the ground, as a part of `ground_height`."""

EARLY_APEX, LATE_APEX = 0.015, 0.1
"""Times after the vertex between which an apex is found [s]; by a descent of 4 mm, it is found after 36 to 52 ms."""

LEAST_FLIGHT, MOST_CHANGE = 0.2, 0.06
"""Duration of a flight from which it is judged [s], and the largest part by which the acceleration of two flights in a
row differs from the slow mean (0.02; a robot that bounces, once 0.08)."""

_YAW_AGAINST_LEG = int(Limited.YAW_AGAINST_LEG)
_PITCH_AGAINST_LEG = int(Limited.PITCH_AGAINST_LEG)
_PITCH_AGAINST_FLIGHT = int(Limited.PITCH_AGAINST_FLIGHT)


class Standing(NamedTuple):
    """Sums over the readings of the present contact, with t and distances since its first reading.

    Each has the weight w, the square of the contact force: a foot slips where it is loaded least, just after touchdown
    and before take-off.

    Attributes:
        readings: Number of readings; 0 in flight.
        begin: Time of the first one [s].
        hip: Travel by the yaw at that time [m].
        foot: Forward distance of the foot from the hip at that time [m].
        latest: t of the latest reading [s].
        w: Σ w.
        t: Σ w t.
        t2: Σ w t².
        f: Σ w f, of the forward distance f of the foot from the hip.
        tf: Σ w t f.
        s: Σ w s, of the travel s of the foot: that of the hip by the yaw, plus f.
        ts: Σ w t s.
    """

    readings: int = 0
    begin: float = 0.0
    hip: float = 0.0
    foot: float = 0.0
    latest: float = 0.0
    w: float = 0.0
    t: float = 0.0
    t2: float = 0.0
    f: float = 0.0
    tf: float = 0.0
    s: float = 0.0
    ts: float = 0.0


class YawEvidence(NamedTuple):
    """Evidence of small faults of the yaw from the stances so far.

    Attributes:
        slip: Slip of the latest stance [m/s].
        variance: Variance of the slip, from the differences of successive stances [m²/s²].
        forward, backward: Evidence of a drift in either direction.
        few, many: Evidence of too few and of too many counts.
    """

    slip: float = 0.0
    variance: float = SLIP_DEVIATION * SLIP_DEVIATION
    forward: float = 0.0
    backward: float = 0.0
    few: float = 0.0
    many: float = 0.0


class Closures(NamedTuple):
    """State of the closures.

    Attributes:
        contact: The present contact.
        evidence: Evidence from those before.
        height: Slow mean of the height of the foot at touchdown [m].
        apex: Time after take-off at which the apex was found [s]; NaN on the ground and before that.
        fall: Slow mean of the vertical acceleration in flight [m/s²]; NaN before the first flight.
        change: Part by which that of the latest flight differed from it.
    """

    contact: Standing = Standing()
    evidence: YawEvidence = YawEvidence()
    height: float = 0.0
    apex: float = np.nan
    fall: float = np.nan
    change: float = 0.0


@as_written
def judge_closures(settings, state, flight, sampled, force, phase, foot_height, body):
    """Returns `Closures` after this tick, and the reasons to doubt yaw or pitch, as the number of a `Limited`.

    Args:
        settings: `TickSettings`.
        state: `HopState` after the tick before.
        flight: `FlightState` of this tick.
        sampled: Time of the reading [s].
        force: Contact force of a foot on the ground [N]; 0 in flight.
        phase: Number of the phase of this tick.
        foot_height: Height of the foot above the ground, by leg and boom [m].
        body: `Body` of this tick.
    """
    before = state.sensors.closures
    doubts = 0
    contact = before.contact
    evidence = before.evidence
    height = before.height
    apex = before.apex
    fall = before.fall
    change = before.change
    if force > 0.0:
        if contact.readings == 0:
            height, doubts = _landed(settings.limits, height, foot_height)
            fall, change, unlike = _flown(before, flight.fit)
            apex = np.nan
            doubts = doubts | unlike
        if sampled > state.sampled:
            contact = _with_reading(contact, sampled, force, body.x, body.foot_x)
    elif contact.readings > 0:
        if contact.latest > LEAST_STANCE and not settings.uneven:  # on a slope, the foot of a healthy robot slips
            evidence, doubts = _stood(evidence, contact)
        contact = _no_contact()
    if phase == Phase.DESCENT and state.phase == Phase.ASCENT:
        apex = flight.fit.latest
    return Closures(contact=contact, evidence=evidence, height=height, apex=apex, fall=fall, change=change), doubts


@as_written
def _no_contact():
    return Standing(
        readings=0, begin=0.0, hip=0.0, foot=0.0, latest=0.0, w=0.0, t=0.0, t2=0.0, f=0.0, tf=0.0, s=0.0, ts=0.0
    )  # fmt: skip


@as_written
def _with_reading(contact, time, force, hip, foot):
    """`Standing` with a reading: its time [s], contact force [N], travel of the hip and distance of the foot [m]."""
    begin = contact.begin
    hip_there = contact.hip
    foot_there = contact.foot
    if contact.readings == 0:
        begin = time
        hip_there = hip
        foot_there = foot
    w = force * force
    t = time - begin
    f = foot - foot_there
    s = hip - hip_there + f
    return Standing(
        readings=contact.readings + 1, begin=begin, hip=hip_there, foot=foot_there, latest=t, w=contact.w + w,
        t=contact.t + w * t, t2=contact.t2 + w * t * t, f=contact.f + w * f, tf=contact.tf + w * t * f,
        s=contact.s + w * s, ts=contact.ts + w * t * s,
    )  # fmt: skip


@as_written
def _landed(limits, mean, height):
    """Slow mean of the height of the foot at touchdown [m] with another one, and a reason to doubt the pitch."""
    mean += MEAN_GAIN * (height - mean)
    return mean, _PITCH_AGAINST_LEG if abs(mean) > FOOT_SHARE * limits.ground_height else 0


@as_written
def _stood(evidence, contact):
    """`YawEvidence` with a contact that has ended, and a reason to doubt the yaw."""
    slip, speed = slip_of(contact)
    pace = abs(speed)
    evidence = with_slip(evidence, slip, speed)
    most = max(max(evidence.forward, evidence.backward), max(evidence.few, evidence.many))
    is_doubted = most > MOST_EVIDENCE or abs(slip) > MOST_SLIP + MOST_SLIP_SHARE * pace
    return evidence, _YAW_AGAINST_LEG if is_doubted else 0


@as_written
def with_slip(before, slip, speed):
    """`YawEvidence` with the slip of another stance and the speed of the foot against the hip [m/s].

    For normal slips of deviation σ, the likelihood of a mean m against one of zero has the logarithm m (slip − m/2) /
    σ². With a tolerance instead of m/2, it is evidence of any mean beyond the tolerance.
    """
    pace = abs(speed)
    least = SLIP_DEVIATION * SLIP_DEVIATION
    most = COUNTED_SLIP + COUNTED_SHARE * pace
    slip = min(most, max(-most, slip))
    change = slip - before.slip
    variance = max(least, before.variance + MEAN_GAIN * (0.5 * change * change - before.variance))
    deviation = np.sqrt(variance)
    tolerance = DRIFT + DRIFT_SHARE * pace
    along = WRONG_SCALE * slip * speed / variance
    square = WRONG_SCALE * pace * pace / variance
    return YawEvidence(
        slip=slip,
        variance=variance,
        forward=max(0.0, before.forward + (slip - tolerance) / deviation),
        backward=max(0.0, before.backward - (slip + tolerance) / deviation),
        few=max(0.0, before.few + along - ALLOWED_FEW * square),
        many=max(0.0, before.many - along - ALLOWED_MANY * square),
    )


@as_written
def slip_of(contact):
    """Slopes of the lines fitted to the travel of the foot, and to its distance from the hip, in a contact [m/s]."""
    spread = contact.w * contact.t2 - contact.t * contact.t
    slip = (contact.w * contact.ts - contact.t * contact.s) / spread
    return slip, (contact.w * contact.tf - contact.t * contact.f) / spread


@as_written
def _flown(before, fit):
    """Slow mean of the acceleration [m/s²], change from it, and a reason to doubt the pitch, after a flight."""
    after = after_vertex(fit)
    fall = vertical_acceleration(fit)
    mean = before.fall
    if np.isnan(before.apex + after) or fit.latest < LEAST_FLIGHT:
        return mean, before.change, 0
    late = before.apex - (fit.latest - after)
    if np.isnan(mean):
        mean = fall
    change = fall / mean - 1.0
    has_changed = min(abs(change), abs(before.change)) > MOST_CHANGE and change * before.change > 0.0
    is_doubted = has_changed or not EARLY_APEX <= late <= LATE_APEX
    return mean + MEAN_GAIN * (fall - mean), change, _PITCH_AGAINST_FLIGHT if is_doubted else 0
