"""Speed and height at the apex from quantised encoders.

One count of the yaw encoder is 2.3 mm of travel, so differencing it at 1 kHz would give speeds in
multiples of 2.3 m/s. In flight, though, the motion is known up to few numbers: the centre of mass
moves on a straight line in x and on a parabola in y. These are fitted to the whole flight so far.
"""

from math import nan

import numpy as np

APEX_DROP = 0.004
"""How far below its highest point the hip is when the apex counts as passed [m]."""

SPEED_DELAY = 0.05
"""Flight time from which on the fitted speed is used [s]."""


class FlightFit:
    """Line and parabola through the samples of one flight.

    Samples are of the hip with the leg's motion taken out: x + S sin α₁ / m_x and y − S cos α₁ / m_y
    move as a free body does.
    """

    def __init__(self) -> None:
        self._times: list[float] = []
        self._xs: list[float] = []
        self._ys: list[float] = []
        self._sum_t = self._sum_x = self._sum_tt = self._sum_tx = 0.0
        self._highest = -np.inf

    def add(self, time: float, x: float, y: float) -> None:
        """Takes the sample at a time since take-off [s], with x relative to take-off [m] and y [m]."""
        self._times.append(time)
        self._xs.append(x)
        self._ys.append(y)
        self._sum_t += time
        self._sum_x += x
        self._sum_tt += time * time
        self._sum_tx += time * x
        self._highest = max(self._highest, y)

    @property
    def apex_passed(self) -> bool:
        """The hip has come down again by APEX_DROP."""
        return bool(self._ys) and self._ys[-1] < self._highest - APEX_DROP

    def speed(self) -> float:
        """Forward speed of the free body [m/s]; NaN before SPEED_DELAY, or of fewer samples than a parabola needs."""
        count = len(self._times)
        if count < 3 or self._times[-1] < SPEED_DELAY:
            return nan
        return (count * self._sum_tx - self._sum_t * self._sum_x) / (count * self._sum_tt - self._sum_t**2)

    def apex_height(self) -> float:
        """Highest point of the fitted parabola [m]."""
        times = np.array(self._times)
        centre = times.mean()
        curvature, slope, level = np.polyfit(times - centre, self._ys, 2)
        return float(level - slope**2 / (4 * curvature)) if curvature < 0 else nan


class JointRates:
    """Rates of the leg angles from motor counts, over the last `span` readings and the time that these took.

    Without a new reading they stay. Of a motion whose acceleration is at most a, they are wrong by no more than a times
    the age of the oldest of those readings, beside what the counts round.
    """

    def __init__(self, span: int = 2):
        self._past: list[tuple[float, float, float]] = []
        self._span, self._rates = span, (0.0, 0.0)

    def update(self, time: float, alpha_1: float, alpha_2: float) -> tuple[float, float]:
        """Takes a reading's time [s] and angles [rad]; returns (α̇₁, α̇₂) [rad/s], zero until there are enough."""
        past = self._past
        if past and time <= past[-1][0]:
            return self._rates
        past.append((time, alpha_1, alpha_2))
        if len(past) > self._span:
            before, old_1, old_2 = past.pop(0)
            took = round(time - before, 12)  # or the time since the start would show in the last digits
            self._rates = (alpha_1 - old_1) / took, (alpha_2 - old_2) / took
        return self._rates
