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
        """Forward speed of the free body [m/s]; NaN before SPEED_DELAY."""
        if not self._times or self._times[-1] < SPEED_DELAY:
            return nan
        count = len(self._times)
        return (count * self._sum_tx - self._sum_t * self._sum_x) / (count * self._sum_tt - self._sum_t**2)

    def apex_height(self) -> float:
        """Highest point of the fitted parabola [m]."""
        times = np.array(self._times)
        centre = times.mean()
        curvature, slope, level = np.polyfit(times - centre, self._ys, 2)
        return float(level - slope**2 / (4 * curvature)) if curvature < 0 else nan


class JointRates:
    """Rates of the leg angles from motor counts, over the last `span` ticks."""

    def __init__(self, tick: float, span: int = 2):
        self._duration = tick * span
        self._past: list[tuple[float, float]] = []
        self._span = span

    def update(self, alpha_1: float, alpha_2: float) -> tuple[float, float]:
        """Takes the angles of this tick [rad]; returns (α̇₁, α̇₂) [rad/s]."""
        past = self._past
        past.append((alpha_1, alpha_2))
        if len(past) <= self._span:
            return 0.0, 0.0
        old_1, old_2 = past.pop(0)
        return (alpha_1 - old_1) / self._duration, (alpha_2 - old_2) / self._duration
