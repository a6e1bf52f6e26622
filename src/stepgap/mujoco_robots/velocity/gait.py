"""What is known of a gait from the velocity of its body alone: its period, its response to commands, and its scatter.

The velocity of a walking robot sways with its steps, so a mean over a part of the period depends on where in the gait
it begins. The period is where the autocorrelation of the velocity at constant commands, taken over forward, sideways
and turning velocity together, has its first high peak. The height of that peak says how strictly the gait is repeated.
"""

from dataclasses import dataclass
from math import nan
from typing import Final

import numpy as np

from stepgap.records.text import listed
from stepgap.step import Array, StepSpace

_SETTLED: Final = 1.0  # Time after a change of command from which on its velocity counts as that of a held command [s]
_SHORTEST: Final = 0.15  # Shortest period that is sought [s]
_LONGEST: Final = 1.6  # Longest one [s]
_HIGH: Final = 0.85  # Part of the height of the highest peak that makes an earlier peak the first high one
_PERIODIC: Final = 0.5  # Height of the peak from which on a gait is called strictly periodic
_OFF: Final = 0.05  # Largest distance of a step from whole periods that still counts as whole [periods]


@dataclass(frozen=True, eq=False)
class ConstantWalk:
    """Velocities of a body during a walk with commands that are held for the same time each.

    Attributes:
        commands: Shape (K, 3) [m/s, m/s, rad/s].
        velocities: Of the body; shape (K, N, 3).
        interval: Time between two samples [s].
    """

    commands: Array
    velocities: Array
    interval: float


@dataclass(frozen=True)
class Gait:
    """What a walk shows of a gait.

    Attributes:
        period: Time after which it repeats itself [s]; NaN if nothing repeats.
        height: Autocorrelation of its velocities at the period, at most 1.
        response: Time after a change of command in which 90 % of the change of velocity is done, for forward, sideways
            and turning velocity; NaN for a velocity that does not follow [s].
        scatter: Standard deviation of the mean velocities over the duration of a step, while the command stays the
            same; (vx, vy, wz) [m/s, m/s, rad/s].
    """

    period: float
    height: float
    response: tuple[float, ...]
    scatter: tuple[float, ...]

    def whole_steps(self, about: float) -> float:
        """Duration of a step of whole periods, near a given one [s]; that one where the gait has no strict period."""
        if not self.height >= _PERIODIC:
            return about
        return self.period * max(1, round(about / self.period))

    def fits(self, seconds: float) -> bool:
        """Whether a duration is a whole number of periods, or the gait has no strict period."""
        periods = seconds / self.period
        return not self.height >= _PERIODIC or (periods > 1 - _OFF and abs(periods - round(periods)) <= _OFF)

    def in_words(self, space: StepSpace) -> str:
        """Period, response and scatter as sentences."""
        responses = zip(space.state_names, self.response, strict=True)
        slow = listed([f"{seconds:.2g} s in {name}" for name, seconds in responses if np.isfinite(seconds)])
        scatter = zip(space.state, np.array(self.scatter) / space.state_scale, strict=True)
        spread = ", ".join(f"{quantity.name} {share:.2g}" for quantity, share in scatter)
        repeats = f"It repeats every {self.period:.3g} s (autocorrelation of its velocities {self.height:.2f})"
        if not self.height >= _PERIODIC:
            repeats = f"It has no strict period (autocorrelation of its velocities {self.height:.2f} at most)"
        follows = f"90 % of a change of command is done after {slow}" if slow else "it follows no command"
        return f"{repeats}; {follows}; at a constant command its steps scatter by {spread} half ranges."


def gait_of(walk: ConstantWalk, seconds: float) -> Gait:
    """What a walk shows of the gait.

    Args:
        seconds: Duration of a step [s].
    """
    interval = walk.interval
    settled = walk.velocities[:, round(_SETTLED / interval) :]
    period, height = gait_period(settled, interval)
    window = max(1, round((period if np.isfinite(period) else seconds) / interval))
    response = tuple(_response(walk, axis, window) for axis in range(walk.commands.shape[1]))
    return Gait(period, height, response, _scatter(settled, max(1, round(seconds / interval))))


def gait_period(velocities: Array, interval: float) -> tuple[float, float]:
    """Period of a gait by the first high peak of the autocorrelation of all velocities, and the height of the peak.

    Args:
        velocities: At constant commands, sampled at equal intervals, in several pieces; shape (K, N, 3).
        interval: Time between two samples [s].

    Returns:
        Period [s], NaN if there is no peak from `_SHORTEST` to `_LONGEST`, and its height, at most 1.
    """
    pieces, length, _ = velocities.shape
    centred = velocities - velocities.mean(axis=1, keepdims=True)
    spread = np.sqrt(np.mean(centred**2, axis=(0, 1)))
    sways = spread > 1e-9
    scaled = centred / np.where(sways, spread, 1.0)
    spectrum = np.abs(np.fft.rfft(scaled, 2 * length, axis=1)) ** 2
    sums = np.fft.irfft(spectrum, 2 * length, axis=1)[:, :length].sum(axis=(0, 2))
    lags = np.arange(length)
    correlation = sums / (pieces * (length - lags) * max(1, np.count_nonzero(sways)))
    last = min(round(_LONGEST / interval), length // 2)
    inner = np.arange(max(round(_SHORTEST / interval), 1), last)
    is_peak = (correlation[inner] >= correlation[inner - 1]) & (correlation[inner] > correlation[inner + 1])
    peaks = inner[is_peak]
    highest = correlation[peaks].max(initial=0.0)
    if highest <= 0:
        return nan, 0.0
    peak = peaks[correlation[peaks] > _HIGH * highest][0]
    before, at, after = correlation[peak - 1 : peak + 2]
    curvature = before - 2 * at + after
    shift = 0.5 * (before - after) / curvature if curvature else 0.0
    return float((peak + shift) * interval), float(min(at, 1.0))


def _response(walk: ConstantWalk, axis: int, window: int) -> float:
    """Time to 90 % of the change of a velocity, by the mean over all changes of its command [s]."""
    changes = np.diff(walk.commands[:, axis])
    velocities = walk.velocities[:, :, axis]
    before = velocities[:-1, -window:].mean(axis=1)
    # The mean response to a unit change, weighted so that it has the least variance.
    rise = changes @ (velocities[1:] - before[:, None]) / max(float(changes @ changes), 1e-12)
    # A mean over a period, which ends at the sample: half a period later than the velocity without its sway.
    smooth = np.convolve(rise, np.ones(window) / window)[: len(rise)]
    final = rise[-3 * window :].mean() if 3 * window < len(rise) else rise[-window:].mean()
    reached = np.flatnonzero(smooth >= 0.9 * final)
    if not (final > 0.1 and len(reached)):
        return nan
    return max(0.0, (reached[0] - window / 2) * walk.interval)


def _scatter(settled: Array, window: int) -> tuple[float, ...]:
    """Standard deviations of means over windows within a piece with one command; (K, N, 3) to (3)."""
    count = settled.shape[1] // window
    if count < 2:
        return (nan,) * settled.shape[2]
    means = settled[:, : count * window].reshape(len(settled), count, window, -1).mean(axis=2)
    return tuple(np.sqrt(np.mean(means.var(axis=1, ddof=1), axis=0)).tolist())
