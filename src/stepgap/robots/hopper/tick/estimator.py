"""Speed and height at the apex from quantised encoders.

One count of the yaw encoder is 2.3 mm of travel, so differencing it at 1 kHz would give speeds in multiples of 2.3 m/s.
In flight, however, the motion has only a few unknown parameters: the centre of mass moves on a parabola in y, and on an
almost straight line in x, because friction and drag of the boom decelerate it a little. Curves are fitted by least
squares to the whole flight so far: parabolas for the state at the apex; a line in x for the landing posture, which
needs the speed soon after take-off. The fits need only sums of powers, so adding a sample takes the same time at every
length of the flight.
"""

from math import inf
from typing import NamedTuple

import numpy as np

from stepgap.base.compiled import as_written

APEX_DROP = 0.004  # Distance of the hip below its highest point at which the apex counts as passed [m]
SPEED_DELAY = 0.05  # Flight time after which the speed of the flight is used [s]

ACCELERATION = 0.05
"""Standard deviation of the horizontal accelerations that are expected in flight [m/s²].

Friction of 0.2 N at the tip of a boom with a moving mass of 4 kg decelerates as much.
"""

CENTRE = 0.15
"""Origin of the times in the sums, as time after take-off [s]; about the middle of an ascent.

With take-off as the origin, cancellation among the fourth powers would cost the height two more digits.
"""

LEVEL = 0.4  # Origin of the heights in the sums [m]


class FlightFit(NamedTuple):
    """Sums over the samples of one flight; with u = time − CENTRE and v = y − LEVEL.

    The samples are positions of the hip, corrected for the leg's motion: x + S sin α₁ / m_x and y − S cos α₁ / m_y
    move as a free body does.

    Attributes:
        samples: Number of samples.
        latest: Time of the latest sample since take-off [s].
        height: y of the latest sample [m].
        highest: Largest y of all samples [m].
        u: Σ u.
        u2: Σ u².
        u3: Σ u³.
        u4: Σ u⁴.
        x: Σ x.
        ux: Σ u x.
        u2x: Σ u² x.
        v: Σ v.
        uv: Σ u v.
        u2v: Σ u² v.
        x2: Σ x².
        v2: Σ v².
    """

    samples: int = 0
    latest: float = 0.0
    height: float = 0.0
    highest: float = -inf
    u: float = 0.0
    u2: float = 0.0
    u3: float = 0.0
    u4: float = 0.0
    x: float = 0.0
    ux: float = 0.0
    u2x: float = 0.0
    v: float = 0.0
    uv: float = 0.0
    u2v: float = 0.0
    x2: float = 0.0
    v2: float = 0.0


NO_SAMPLES = FlightFit()  # At take-off


@as_written
def with_sample(fit, time, x, y):
    """`FlightFit` with a sample added: time since take-off [s], x relative to take-off [m], y [m]."""
    u = time - CENTRE
    v = y - LEVEL
    u2 = u * u
    return FlightFit(
        samples=fit.samples + 1, latest=time, height=y, highest=max(fit.highest, y), u=fit.u + u, u2=fit.u2 + u2,
        u3=fit.u3 + u2 * u, u4=fit.u4 + u2 * u2, x=fit.x + x, ux=fit.ux + u * x, u2x=fit.u2x + u2 * x, v=fit.v + v,
        uv=fit.uv + u * v, u2v=fit.u2v + u2 * v, x2=fit.x2 + x * x, v2=fit.v2 + v * v,
    )  # fmt: skip


@as_written
def apex_passed(fit):
    """Whether the hip has descended by APEX_DROP from its highest point."""
    return fit.height < fit.highest - APEX_DROP


@as_written
def mean_speed(fit):
    """Slope of the line fitted to x, the mean forward speed of the free body in the flight so far [m/s].

    It has little noise soon after take-off, and at touchdown, after equally long ascent and descent, it is the speed at
    the apex. NaN before SPEED_DELAY or with fewer samples than a parabola needs.
    """
    if fit.samples < 3 or fit.latest < SPEED_DELAY:
        return np.nan
    return (fit.samples * fit.ux - fit.u * fit.x) / (fit.samples * fit.u2 - fit.u * fit.u)


@as_written
def fitted_apex(fit, count):
    """Forward speed [m/s] and height [m] of the free body at the apex, the vertex of the parabola fitted to y.

    With w = u − mean(u) and W_k = Σ w^k the polynomials 1, w and q = w² − (W₃/W₂) w − W₂/n are orthogonal over the
    samples, so each coefficient is computed separately. The speed is the derivative of the parabola fitted to x.

    The curvature of x has the normal prior of half an acceleration with standard deviation ACCELERATION, so that its
    estimate is Σ q x / (Σ q² + (2σ / ACCELERATION)²) for independent errors σ of the samples. It matters only if the
    robot hardly moves: the rounding errors of n samples at constant speed almost cancel over each whole count, so while
    the robot moves by M counts, their mean has a standard deviation of about count/√12 / (1 + M) = σ/√n.

    Args:
        fit: `FlightFit`.
        count: One count of the yaw encoder as travel of the hip [m].

    Returns:
        Speed and height; NaN where `mean_speed` is, or where the parabola of y has no maximum.
    """
    if np.isnan(mean_speed(fit)):
        return np.nan, np.nan
    n = fit.samples
    m, w2, skew, level, q2 = _polynomials(fit)
    wv, qv = _projections(m, skew, level, fit.v, fit.uv, fit.u2v)
    curvature = qv / q2
    if not curvature < 0.0:
        return np.nan, np.nan
    slope = wv / w2 - curvature * skew  # of y at w = 0
    apex = -slope / (2.0 * curvature)
    height = LEVEL + (fit.v - curvature * w2) / n - slope * slope / (4.0 * curvature)
    wx, qx = _projections(m, skew, level, fit.x, fit.ux, fit.u2x)
    mean = wx / w2
    rounding = count * count / (count + abs(mean) * fit.latest)  # count / (1 + M)
    curvature_x = qx / (q2 + n * rounding * rounding / (3.0 * ACCELERATION * ACCELERATION))
    return mean + curvature_x * (2.0 * apex - skew), height


@as_written
def vertical_acceleration(fit):
    """Upward acceleration of the free body in the flight so far [m/s²], from the parabola fitted to y.

    NaN where `mean_speed` is.
    """
    if np.isnan(mean_speed(fit)):
        return np.nan
    m, _, skew, level, q2 = _polynomials(fit)
    return 2.0 * _projections(m, skew, level, fit.v, fit.uv, fit.u2v)[1] / q2


@as_written
def after_vertex(fit):
    """Time of the latest sample after the vertex of the parabola fitted to y [s], before it negative.

    NaN where `mean_speed` is, and where the parabola has no maximum.
    """
    if np.isnan(mean_speed(fit)):
        return np.nan
    m, w2, skew, level, q2 = _polynomials(fit)
    wv, qv = _projections(m, skew, level, fit.v, fit.uv, fit.u2v)
    curvature = qv / q2
    if not curvature < 0.0:
        return np.nan
    slope = wv / w2 - curvature * skew  # of y at w = 0
    return fit.latest - CENTRE - m + slope / (2.0 * curvature)


@as_written
def scatter_about_parabolas(fit):
    """Mean squares of what parabolas fitted to x and to y leave of them in the flight so far [m²].

    Σ z² − (Σ z)² / n − (Σ w z)² / Σ w² − (Σ q z)² / Σ q² is the sum of squares that the three orthogonal polynomials of
    `fitted_apex` leave of z. NaN where `mean_speed` is.
    """
    if np.isnan(mean_speed(fit)):
        return np.nan, np.nan
    n = fit.samples
    m, w2, skew, level, q2 = _polynomials(fit)
    wx, qx = _projections(m, skew, level, fit.x, fit.ux, fit.u2x)
    wv, qv = _projections(m, skew, level, fit.v, fit.uv, fit.u2v)
    left_x = fit.x2 - fit.x * fit.x / n - wx * wx / w2 - qx * qx / q2
    left_y = fit.v2 - fit.v * fit.v / n - wv * wv / w2 - qv * qv / q2
    return left_x / n, left_y / n


@as_written
def _polynomials(fit):
    """mean(u), Σ w², skew, level and Σ q², as in `fitted_apex`."""
    m = fit.u / fit.samples
    w2 = fit.u2 - m * fit.u
    w3 = fit.u3 - m * (3.0 * fit.u2 - 2.0 * m * fit.u)
    w4 = fit.u4 - m * (4.0 * fit.u3 - m * (6.0 * fit.u2 - 3.0 * m * fit.u))
    skew = w3 / w2
    level = w2 / fit.samples
    return m, w2, skew, level, w4 - skew * w3 - w2 * level


@as_written
def _projections(m, skew, level, z, uz, u2z):
    """Σ w z and Σ q z from Σ z, Σ u z and Σ u² z; with w = u − m and q = w² − skew w − level."""
    wz = uz - m * z
    return wz, u2z - m * (2.0 * uz - m * z) - skew * wz - level * z


class JointRates(NamedTuple):
    """Rates of the leg angles from motor counts: differences over the last two intervals between readings.

    Without a new reading the rates stay as they are. For accelerations up to a, their error is at most a times the age
    of the oldest of these readings, plus the effect of rounding to counts.

    Attributes:
        readings: Number of readings, counted up to 2.
        time: Time of the latest reading [s].
        alpha_1: α₁ of the latest reading [rad].
        alpha_2: α₂ of the latest reading [rad].
        time_before: Time of the previous reading [s].
        alpha_1_before: α₁ of the previous reading [rad].
        alpha_2_before: α₂ of the previous reading [rad].
        rate_1: α̇₁ [rad/s], zero until there are three readings.
        rate_2: α̇₂ [rad/s].
    """

    readings: int = 0
    time: float = 0.0
    alpha_1: float = 0.0
    alpha_2: float = 0.0
    time_before: float = 0.0
    alpha_1_before: float = 0.0
    alpha_2_before: float = 0.0
    rate_1: float = 0.0
    rate_2: float = 0.0


@as_written
def with_reading(rates, time, alpha_1, alpha_2):
    """`JointRates` updated by the angles [rad] of a reading at a time [s]; a reading that is not new has no effect."""
    rate_1 = rates.rate_1
    rate_2 = rates.rate_2
    before = rates.time_before
    readings = rates.readings
    latest = rates.time
    old_1 = rates.alpha_1
    old_2 = rates.alpha_2
    past_1 = rates.alpha_1_before
    past_2 = rates.alpha_2_before
    if readings == 0 or time > latest:
        if readings == 2:
            # rounded to picoseconds, so that the last digits do not depend on the time since the start
            took = np.rint(1e12 * (time - before)) / 1e12
            rate_1 = (alpha_1 - past_1) / took
            rate_2 = (alpha_2 - past_2) / took
        before = latest
        past_1 = old_1
        past_2 = old_2
        readings = min(readings + 1, 2)
        latest = time
        old_1 = alpha_1
        old_2 = alpha_2
    return JointRates(
        readings=readings, time=latest, alpha_1=old_1, alpha_2=old_2, time_before=before, alpha_1_before=past_1,
        alpha_2_before=past_2, rate_1=rate_1, rate_2=rate_2,
    )  # fmt: skip
