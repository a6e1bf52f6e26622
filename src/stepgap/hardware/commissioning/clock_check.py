"""Check of distributed clocks: frames at their times on the reference clock, and slaves' clocks that follow it."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.rigs.rig import CLOCK_DIFFERENCE, CLOCK_OFFSET, CLOCK_OUTSIDE, ClockLimits
from stepgap.step import Array

USUAL = 0.999
"""Fraction of the ticks whose frames must be within the usual distance."""

UNSETTLED = 500
"""Number of ticks at the beginning in which frames and clocks approach their times; at most half of all."""

_LATE = (
    "frames are late if ticks are, or if the work of a tick varies: use a quieter machine; or choose a larger `tick` "
    "or fewer `frames_per_tick`, since the window is a share of the cycle"
)
_APART = (
    "its `assign_activate` may be wrong, so read its ESI file; lost frames disturb clocks, too, so check cables and "
    "connectors"
)


@dataclass(frozen=True)
class ClockCheck:
    """Distances of frames from their times on the reference clock of a bus, and of the slaves' clocks from it.

    Of several frames per tick, the one that is farthest from its time counts. The first `UNSETTLED` ticks count for
    `outside` only.

    Attributes:
        limits: What is allowed.
        ticks: Number of ticks with a known distance; without any, the others are zero.
        p50: Median of the distances [s].
        p99_9: 99.9 % quantile [s].
        worst: Largest distance [s].
        jitter: 99.9 % quantile of the change of the distance from tick to tick [s].
        outside: Largest number of consecutive frames outside of the window.
        differences: Largest difference of each slave's clock [s], by the name of the slave; None if it was never read.
    """

    limits: ClockLimits
    ticks: int = 0
    p50: float = 0.0
    p99_9: float = 0.0
    worst: float = 0.0
    jitter: float = 0.0
    outside: int = 0
    differences: Mapping[str, float | None] = field(default_factory=dict)

    def failures(self) -> list[str]:
        """Describes what is not within the limits, with remedies; empty if everything is."""
        if not self.ticks:
            return ["no frame reported its time on the reference clock"]
        limits, found = self.limits, []
        if self.p99_9 > limits.usual:
            found.append(
                f"99.9 % of the frames were within {_micro(self.p99_9)} of their times on the reference clock, "
                f"but must be within {_micro(limits.usual)} (dc.usual): {_LATE}"
            )
        if self.outside > limits.outside:
            found.append(
                f"{self.outside} frames in a row were outside of the window of {_micro(limits.window)}, "
                f"at most {limits.outside} are allowed (dc.outside): {_LATE}"
            )
        found += [
            f"the clock of {slave} differed by {_micro(difference)} from the reference clock, at most "
            f"{_micro(limits.difference)} are allowed (dc.difference): {_APART}"
            for slave, difference in self.differences.items()
            if difference is not None and difference > limits.difference
        ]
        silent = [slave for slave, difference in self.differences.items() if difference is None]
        if silent:
            found.append(
                f"{', '.join(silent)} never reported the difference of its clock (0x092C): measure for longer "
                "(--seconds), or check reply_timeout"
            )
        return found

    def describe(self) -> str:
        """The result in one line."""
        known = [difference for difference in self.differences.values() if difference is not None]
        apart = f"within {_micro(max(known))}" if known else "unknown"
        return (
            f"frames within {_micro(self.p99_9)} of their times (99.9 %), {_micro(self.worst)} at most, at most "
            f"{self.outside} in a row outside of the window; jitter {_micro(self.jitter)} (99.9 %); "
            f"slaves' clocks {apart}"
        )


def clock_check(ticks: TickTable, limits: ClockLimits | None) -> ClockCheck | None:
    """Computes how frames and clocks followed the reference clock; None without distributed clocks.

    Args:
        ticks: Ticks of a rig that logs `CLOCK_OFFSET`.
        limits: What is allowed; None without distributed clocks.
    """
    if limits is None or CLOCK_OFFSET not in ticks.units:
        return None
    settled = replace(ticks, rows=ticks.rows[min(UNSETTLED, len(ticks) // 2) :])
    offsets = settled[CLOCK_OFFSET]
    offsets = offsets[np.isfinite(offsets)]
    if not len(offsets):
        return ClockCheck(limits)
    distances, changes = np.abs(offsets), np.abs(np.diff(offsets))
    p50, p99_9 = np.quantile(distances, (0.5, USUAL)).tolist()
    return ClockCheck(
        limits=limits,
        ticks=len(offsets),
        p50=p50,
        p99_9=p99_9,
        worst=float(distances.max()),
        jitter=float(np.quantile(changes, USUAL)) if len(changes) else 0.0,
        outside=int(np.nanmax(ticks[CLOCK_OUTSIDE])),  # also at the beginning
        differences={
            name.removesuffix(f"_{CLOCK_DIFFERENCE}").replace("_", " "): _largest(settled[name])
            for name in ticks.units
            if name.endswith(CLOCK_DIFFERENCE)
        },
    )


def _largest(differences: Array) -> float | None:
    """Largest absolute difference; None if none is known."""
    known = np.abs(differences[np.isfinite(differences)])
    return float(known.max()) if len(known) else None


def _micro(time: float) -> str:
    return f"{1e6 * time:.1f} µs" if time >= 1e-7 else f"{1e6 * time:.3f} µs"
