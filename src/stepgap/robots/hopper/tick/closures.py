"""Closures: what yaw and pitch say of a hop, compared in size with the leg and the laws of flight; compiled.

In stance the foot is at rest, so the hip travels as far by the yaw as the leg swings over the foot: the *slip*, the
speed of the foot by both, is zero. At touchdown the foot is on the ground, by leg and pitch. In flight the hip falls
with the same acceleration as in the flights before, the apex is found just after the vertex of the parabola, and the
yaw follows a parabola as well.

How far the height of the foot and the acceleration scatter differs from robot to robot and from floor to floor, so that
the band in which they are believed is learned from the first hops (`Steady`).

A closure of one hop shows a large fault only, since the yaw is rounded and a foot slips. So evidence of a small fault
is collected over stances, as a sequential test does: for a drift of the yaw in either direction, and for too many or
too few counts in proportion to the travel. Each sum is a logarithm of likelihoods and is never negative.

The largest values of 21 healthy twins of the family, 227 hops each, are given beside the thresholds; those of `Steady`
and of flights are of 14 twins, 60 hops each, six of them on a floor with a roughness of 3 mm and a slope of 3 mrad.
"""

from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written
from stepgap.robots.hopper.tick.estimator import after_vertex, scatter_about_parabolas, vertical_acceleration
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import Limited

LEAST_STANCE = 0.06
"""Duration of a contact from which its slip is known well enough [s]; those of hops take 0.09 to 0.17 s."""

MOST_SLIP = 0.2
MOST_SLIP_SHARE = 0.1
"""Largest slip of one stance [m/s], and in addition as a part of the speed of the leg (0.16 at 0.6 m/s)."""

COUNTED_SLIP = 0.03
COUNTED_SHARE = 0.05
"""Largest slip that counts as evidence [m/s], and in addition as a part of that speed, since a foot does slip once."""

SLIP_DEVIATION = 0.007
"""Least standard deviation of the slip [m/s]; what is more on a robot whose foot slips often is measured."""

DRIFT = 0.008
DRIFT_SHARE = 0.03
"""Mean slip that is no evidence of a drift [m/s], and in addition as a part of the speed of the leg."""

WRONG_SCALE = 0.1
ALLOWED_FEW = 0.07
ALLOWED_MANY = 0.04
"""Error of scale for which evidence is collected, and allowed ones: a foot that slips backward seems to be too few
counts for the swing of the leg."""

SLIP_ON_SLOPE = 1.0
ALLOWED_UNEVEN = 0.08
"""Mean slip on measured ground that is no evidence of a wrong scale, per slope [m/s], since a foot slips down a slope
(0.9), and the allowed error of scale there. Up and down cancel, so that only the slow mean of the slope counts. A drift
is not judged there."""

SCALE_PRIOR = 0.1
DISK_PRIOR = 0.03
SLOPE_PRIOR = 0.5
CONSTANT_PRIOR = 0.02
"""Standard deviations expected of the coefficients of `SlipFit`; of the last two in m/s."""

FORGOTTEN = 0.025  # Part of the weight of a stance in `SlipFit` that is lost with each later one
FITTED_SHARE = 0.25  # As `COUNTED_SHARE`, in `SlipFit`
COUNTED_ON_SLOPE = 1.0  # Largest slip that counts there in addition, per slope of the ground [m/s]

ALLOWED_FIT = 0.06  # Error of scale that is allowed in `SlipFit`
LEAST_EFFECT = 0.005  # Effect on the speed from which a coefficient matters [m/s]

EVEN_SCALE = 2.5
UNEVEN_SCALE = 4.5
ECCENTRIC = 5.0
"""Standard deviations beyond which a coefficient of `SlipFit` is wrong: the scale, on measured ground as well (0.0 and
3.0), and the dependence on the yaw (3.3)."""

SLOWEST_UNEVEN = 0.15  # Mean speed from which the scale is judged by `SlipFit` on measured ground [m/s]

MOST_EVIDENCE = 8.0  # Evidence from which the yaw is doubted (4.6)
MEAN_GAIN = 0.2  # Weight of the latest hop in slow means

FOOT_SHARE = 0.5
"""Largest slow mean of the height of the foot at touchdown above or below the ground, as a part of `ground_height`; so
much may that height change from hop to hop, too, until its scatter is known."""

LEARNED = 10
BAND = 6.0
"""Number of hops from which the scatter of a quantity is known, and the largest deviation of two hops in a row from the
slow mean, as a multiple of its standard deviation (4.6)."""

SCATTER_GAIN = 0.1
MOST_DEVIATION = 2.0
"""Weight of the latest hop in that variance, and the largest deviation that counts in it, as a multiple of the standard
deviation, but at least a part of the least band: a fault must not widen its own band."""

LEAST_PART = 0.3  # That part; without it a variance of zero would never grow

FOOT_BAND = 0.0025
"""Least band of the height of the foot at touchdown [m]; deviations of two hops in a row were up to 1.6 mm on floors of
the family."""

EARLY_APEX = 0.015
LATE_APEX = 0.1
"""Times after the vertex between which an apex is found [s]; by a descent of 4 mm, it is found after 36 to 52 ms."""

LEAST_FLIGHT = 0.2
FALL_BAND = 0.02
"""Duration of a flight from which it is judged [s], and the least band of its vertical acceleration as a part of it
(0.008; on measured ramps 0.011), which holds from the first flights on."""

CROOKED = 0.001
CROOKED_COUNTS = 0.43
CROOKED_SHARE = 2.0
"""Standard deviation of the hip about a parabola from which the yaw of a flight is wrong [m], and that in counts of the
yaw, of which rounding makes 0.3; in addition a multiple of that of its height, since links that vibrate shake both
(0.8 of the sum)."""

FREE = 0.0007
FREE_COUNTS = 1.0
"""The same of its height [m], and in counts of the pitch, up to which the robot flies without a disturbance: else its
acceleration is not judged, nor its yaw on measured ground, where a foot may hit a riser."""

CROOKED_GAIN = 0.05
MOST_CROOKED = 1.4
"""Number of flights with a wrong yaw from which it is doubted, each with the weight 1 − `CROOKED_GAIN` per flight since
then: two of 18, so that one push is no reason to stop (0)."""

_TURN = 2.0 * np.pi
_YAW_AGAINST_LEG = int(Limited.YAW_AGAINST_LEG)
_YAW_NOISY = int(Limited.YAW_NOISY)
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


_NO_CONTACT = Standing()


class YawEvidence(NamedTuple):
    """Evidence of small faults of the yaw from the stances so far.

    Attributes:
        slip: Slip of the latest stance [m/s].
        variance: Variance of the slip, from the differences of successive stances [m²/s²].
        forward, backward: Evidence of a drift in either direction.
        few, many: Evidence of too few and of too many counts.
        slope: Slow mean of the slope of measured ground; 0 on other ground.
    """

    slip: float = 0.0
    variance: float = SLIP_DEVIATION * SLIP_DEVIATION
    forward: float = 0.0
    backward: float = 0.0
    few: float = 0.0
    many: float = 0.0
    slope: float = 0.0


class SlipFit(NamedTuple):
    """Weighted sums over the stances so far, of the slip and of three quantities on which it may depend.

    The first is the speed of the hip against the foot, whose coefficient is an error of scale of the yaw. The others
    are its products with the cosine and the sine of the yaw, as of a disk whose centre is not on the axis; on measured
    ground the slope, down which feet slip, and 1.

    Attributes:
        a, b, c, d, e, f: Sums of the products of the quantities 1·1, 1·2, 1·3, 2·2, 2·3, 3·3.
        x, y, z: Those of the quantities and the slip.
        s: That of the squares of the slip.
        stances: Sum of the weights.
    """

    a: float = 0.0
    b: float = 0.0
    c: float = 0.0
    d: float = 0.0
    e: float = 0.0
    f: float = 0.0
    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    s: float = 0.0
    stances: float = 0.0


class Steady(NamedTuple):
    """A quantity that is nearly the same in each hop, and how far it scatters.

    Attributes:
        number: Number of its values so far.
        mean: Slow mean; of the first values, their mean.
        variance: Variance of the deviations from it.
        off: Deviation of the latest value from the mean before it.
    """

    number: int = 0
    mean: float = 0.0
    variance: float = 0.0
    off: float = 0.0


class Closures(NamedTuple):
    """State of the closures.

    Attributes:
        contact: The present contact.
        evidence: Evidence from those before.
        fit: On what their slip depends.
        height: Height of the foot at touchdown above the ground [m].
        apex: Time after take-off at which the apex was found [s]; NaN on the ground and before that.
        fall: Vertical acceleration in flight [m/s²].
        crooked: Weighted number of the latest flights in which the yaw was wrong.
    """

    contact: Standing = Standing()
    evidence: YawEvidence = YawEvidence()
    fit: SlipFit = SlipFit()
    height: Steady = Steady()
    apex: float = np.nan
    fall: Steady = Steady()
    crooked: float = 0.0


def resumed(numbers: Sequence[float]) -> Closures:
    """`Closures` at the begin of a deployment, with `evidence`, `fit`, `fall` and `crooked` of the one before.

    The height of the foot begins anew: the deployment may be elsewhere on the floor.
    """
    parts = iter(numbers)
    evidence = YawEvidence(*islice(parts, len(YawEvidence._fields)))
    fit = SlipFit(*islice(parts, len(SlipFit._fields)))
    number, *fall = islice(parts, len(Steady._fields))
    return Closures(evidence=evidence, fit=fit, fall=Steady(int(number), *fall), crooked=next(parts))


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
    fit = before.fit
    height = before.height
    apex = before.apex
    fall = before.fall
    crooked = before.crooked
    if force > 0.0:
        if contact.readings == 0:
            height, doubts = _landed(settings, height, foot_height)
            fall, crooked, unlike = _flown(settings, before, flight.fit)
            apex = np.nan
            doubts = doubts | unlike
        if sampled > state.sampled:
            contact = _with_reading(contact, sampled, force, body.x, body.foot_x)
    elif contact.readings > 0:
        if contact.latest > LEAST_STANCE:
            evidence, fit, doubts = _stood(settings.uneven, before, contact, state.landing.slope, body.yaw)
        contact = _NO_CONTACT
    if phase == Phase.DESCENT and state.phase == Phase.ASCENT:
        apex = flight.fit.latest
    after = Closures(contact=contact, evidence=evidence, fit=fit, height=height, apex=apex, fall=fall, crooked=crooked)
    return after, doubts


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
def steady_with(before, value, least, at_first):
    """`Steady` with another value, and whether the latest two are not like the others, in the same direction.

    Args:
        before: `Steady` before.
        value: The value.
        least: Least band about the mean in which values are believed.
        at_first: The band until the scatter is known.
    """
    number = before.number
    off = value - before.mean if number > 0 else 0.0
    both = min(abs(off), abs(before.off)) if off * before.off > 0.0 else 0.0
    deviation = np.sqrt(before.variance)
    band = max(least, BAND * deviation) if number >= LEARNED else at_first
    counted = min(abs(off), max(LEAST_PART * least, MOST_DEVIATION * deviation))
    moved = min(band, max(-band, off))  # one value alone hardly moves the mean
    gain = max(SCATTER_GAIN, 1.0 / max(1, number))
    return Steady(
        number=number + 1,
        mean=before.mean + moved * max(MEAN_GAIN, 1.0 / (number + 1)) if number > 0 else value,
        variance=before.variance + gain * (counted * counted - before.variance) if number > 0 else 0.0,
        off=off,
    ), both > band


@as_written
def _landed(settings, height, value):
    """`Steady` height of the foot at touchdown with another one [m], and a reason to doubt the pitch.

    On uneven ground, where it is the step to the ground before, it may be anything, but not for long.
    """
    most = FOOT_SHARE * settings.limits.ground_height
    height, has_changed = steady_with(height, value, FOOT_BAND, most)
    is_wrong = MEAN_GAIN * height.number >= 1.0 and abs(height.mean) > most
    return height, _PITCH_AGAINST_LEG if is_wrong or (has_changed and not settings.uneven) else 0


@as_written
def _stood(uneven, before, contact, slope, yaw):
    """`YawEvidence` and `SlipFit` with a contact that has ended, and a reason to doubt the yaw."""
    slip, speed = slip_of(contact)
    evidence = with_slip(before.evidence, slip, speed, uneven, slope)
    most = max(max(evidence.forward, evidence.backward), max(evidence.few, evidence.many))
    is_doubted = most > MOST_EVIDENCE or abs(slip) > MOST_SLIP + MOST_SLIP_SHARE * abs(speed)
    if uneven:
        fit = with_stance(before.fit, slip, -speed, slope, 1.0, COUNTED_ON_SLOPE * abs(slope))
        of_scale, _ = suspicions(fit, SLOPE_PRIOR, CONSTANT_PRIOR)
        moves = fit.a > SLOWEST_UNEVEN * SLOWEST_UNEVEN * fit.stances
        is_doubted = is_doubted or (moves and of_scale > UNEVEN_SCALE)
    else:
        fit = with_stance(before.fit, slip, -speed, -speed * np.cos(yaw), -speed * np.sin(yaw), 0.0)
        of_scale, of_disk = suspicions(fit, DISK_PRIOR, DISK_PRIOR)
        is_doubted = is_doubted or of_scale > EVEN_SCALE or of_disk > ECCENTRIC
    return evidence, fit, _YAW_AGAINST_LEG if is_doubted else 0


@as_written
def with_stance(before, slip, speed, second, third, more):
    """`SlipFit` with another stance.

    Args:
        before: `SlipFit` before.
        slip: Slip of the foot by yaw and leg [m/s].
        speed: Speed of the hip against the foot [m/s].
        second, third: The other two quantities on which the slip may depend.
        more: By how much more than elsewhere a foot may slip here [m/s].
    """
    most = COUNTED_SLIP + FITTED_SHARE * abs(speed) + more
    slip = min(most, max(-most, slip))
    kept = 1.0 - FORGOTTEN
    return SlipFit(
        a=kept * before.a + speed * speed, b=kept * before.b + speed * second, c=kept * before.c + speed * third,
        d=kept * before.d + second * second, e=kept * before.e + second * third, f=kept * before.f + third * third,
        x=kept * before.x + speed * slip, y=kept * before.y + second * slip, z=kept * before.z + third * slip,
        s=kept * before.s + slip * slip, stances=kept * before.stances + 1.0,
    )  # fmt: skip


@as_written
def suspicions(fit, prior_2, prior_3):
    """How many standard deviations the scale of the yaw, and its dependence on the yaw itself, are beyond what feet do.

    Coefficients β of the slip have normal priors of mean zero. With A the sum of the squares of the quantities and of
    the inverse variances of the priors, β = A⁻¹ Σ q slip, and A⁻¹ times the mean square that remains is their
    covariance.

    Args:
        fit: `SlipFit`.
        prior_2, prior_3: Standard deviations of the coefficients of the second and third quantity.

    Returns:
        Of the scale, and of the two other coefficients; 0 where the robot is too slow for it to matter.
    """
    noise = SLIP_DEVIATION * SLIP_DEVIATION
    a = fit.a + noise / (SCALE_PRIOR * SCALE_PRIOR)
    d = fit.d + noise / (prior_2 * prior_2)
    f = fit.f + noise / (prior_3 * prior_3)
    b = fit.b
    c = fit.c
    e = fit.e
    # A⁻¹ is the matrix of these cofactors, divided by the determinant
    aa = d * f - e * e
    ab = c * e - b * f
    ac = b * e - c * d
    dd = a * f - c * c
    de = b * c - a * e
    ff = a * d - b * b
    det = a * aa + b * ab + c * ac
    scale = (aa * fit.x + ab * fit.y + ac * fit.z) / det
    second = (ab * fit.x + dd * fit.y + de * fit.z) / det
    third = (ac * fit.x + de * fit.y + ff * fit.z) / det
    left = fit.s - scale * fit.x - second * fit.y - third * fit.z
    variance = max(noise, left / max(1.0, fit.stances - 3.0))
    speed = np.sqrt(fit.a / fit.stances)
    of_scale = (abs(scale) - ALLOWED_FIT) / np.sqrt(variance * aa / det)
    # the covariance of the two is variance (dd, de; de, ff) / det
    square = (ff * second * second - 2.0 * de * second * third + dd * third * third) * det
    of_others = np.sqrt(max(0.0, square / (variance * (dd * ff - de * de))))
    matters = np.sqrt(second * second + third * third) * speed > LEAST_EFFECT
    return (of_scale if abs(scale) * speed > LEAST_EFFECT else 0.0), (of_others if matters else 0.0)


@as_written
def with_slip(before, slip, speed, uneven, slope):
    """`YawEvidence` with the slip of another stance and the speed of the foot against the hip [m/s].

    On uneven ground, whose slope is measured, feet slip more.

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
    tolerance = np.inf if uneven else DRIFT + DRIFT_SHARE * pace
    slope = before.slope + MEAN_GAIN * (slope - before.slope) if uneven else 0.0
    slipped = SLIP_ON_SLOPE * abs(slope) * WRONG_SCALE * pace / variance
    allowed_few = ALLOWED_UNEVEN if uneven else ALLOWED_FEW
    allowed_many = ALLOWED_UNEVEN if uneven else ALLOWED_MANY
    along = WRONG_SCALE * slip * speed / variance
    square = WRONG_SCALE * pace * pace / variance
    return YawEvidence(
        slip=slip,
        variance=variance,
        forward=max(0.0, before.forward + (slip - tolerance) / deviation),
        backward=max(0.0, before.backward - (slip + tolerance) / deviation),
        few=max(0.0, before.few + along - allowed_few * square - slipped),
        many=max(0.0, before.many - along - allowed_many * square - slipped),
        slope=slope,
    )


@as_written
def slip_of(contact):
    """Slopes of the lines fitted to the travel of the foot, and to its distance from the hip, in a contact [m/s]."""
    spread = contact.w * contact.t2 - contact.t * contact.t
    slip = (contact.w * contact.ts - contact.t * contact.s) / spread
    return slip, (contact.w * contact.tf - contact.t * contact.f) / spread


@as_written
def _flown(settings, before, fit):
    """`Steady` acceleration [m/s²] after a flight, `Closures.crooked`, and the reasons to doubt pitch or yaw."""
    model = settings.sensor_model
    fall = before.fall
    crooked = before.crooked
    after = after_vertex(fit)
    if np.isnan(before.apex + after) or fit.latest < LEAST_FLIGHT:
        return fall, crooked, 0
    late = before.apex - (fit.latest - after)
    doubts = 0 if EARLY_APEX <= late <= LATE_APEX else _PITCH_AGAINST_FLIGHT
    square_x, square_y = scatter_about_parabolas(fit)
    scatter_y = np.sqrt(max(0.0, square_y))
    free = scatter_y <= max(FREE, FREE_COUNTS * _TURN * model.boom_length / model.boom_counts_vertical)
    if free:
        band = FALL_BAND * abs(fall.mean)
        fall, has_changed = steady_with(fall, vertical_acceleration(fit), band, band)
        doubts |= _PITCH_AGAINST_FLIGHT if has_changed else 0
    if free or not settings.uneven:
        count = _TURN * model.boom_length / model.boom_counts_horizontal
        most = max(CROOKED, CROOKED_COUNTS * count) + CROOKED_SHARE * scatter_y
        crooked = (1.0 - CROOKED_GAIN) * crooked + (1.0 if square_x > most * most else 0.0)
        doubts |= _YAW_NOISY if crooked > MOST_CROOKED else 0
    return fall, crooked, doubts
