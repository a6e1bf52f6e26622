"""Time intervals in which a condition holds, such as that a robot is in the air, without the glitches of its sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.local_fit import rounding_of
from stepgap.logs.sections.signals import Signal
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

GLITCH: Final = 0.2  # A phase is a glitch if it is shorter than this part of a typical phase of its kind
SHORT_PHASE: Final = 0.4  # A phase is doubtful if it is shorter than this part of a typical phase of its kind

HIGH, LOW = 0.3, 0.1
"""A foot touches down where its force exceeds HIGH of the force in firm contact, and lifts off below LOW of it."""


@final
@dataclass(frozen=True)
class AerialPhase:
    """A time interval in which a condition holds without interruption.

    Attributes:
        begin: Begin [s].
        end: End [s].
        resolution: Time between samples, within which begin and end are known [s].
        doubts: Why it may be no such interval; empty if it certainly is.
    """

    begin: float
    end: float
    resolution: float
    doubts: tuple[str, ...] = ()


def aerial_phases(time: Array, inside: NDArray[np.bool_]) -> list[AerialPhase]:
    """The complete intervals in which a condition holds.

    Changes that last less than `GLITCH` of a typical phase are removed, the shortest first. The typical duration of a
    phase is such that half of the total time is spent in longer ones, so that glitches do not count. The first and the
    last phase are incomplete, so they are left out.

    Args:
        time: Times of the samples [s]; shape (R,).
        inside: Whether the condition holds; shape (R,).
    """
    changes = np.flatnonzero(inside[1:] != inside[:-1])
    edges = [float(time[0]), *((time[changes] + time[changes + 1]) / 2).tolist(), float(time[-1])]
    kinds = [bool(inside[0]) ^ bool(number % 2) for number in range(len(edges) - 1)]
    while (shortest := _glitch(edges, kinds)) is not None:
        # Both its ends are removed, and the phases before and after it become one.
        del edges[shortest : shortest + 2], kinds[shortest : shortest + 2]
    durations = np.diff(edges)
    typical = _typical(edges, kinds)
    short = [bool(each < SHORT_PHASE * typical[kind]) for each, kind in zip(durations, kinds, strict=True)]
    resolution = float(np.median(np.diff(time)) or np.mean(np.diff(time)))
    found: list[AerialPhase] = []
    for number in range(1, len(kinds) - 1):
        if kinds[number]:
            doubts = ["unusually short phase"] if short[number] else []
            doubts += ["unusually short interruption"] if short[number - 1] or short[number + 1] else []
            found.append(AerialPhase(edges[number], edges[number + 1], resolution, tuple(doubts)))
    return found


def airborne(force: Signal, threshold: float | None) -> NDArray[np.bool_]:
    """Whether a foot is in the air, by its force with hysteresis; shape (R,).

    Args:
        force: Force of the ground on the foot, positive in contact.
        threshold: Force above which the foot is in contact, and below a third of which it is in the air. If None, parts
            of the force in firm contact, its 95th percentile.

    Raises:
        RecordError: The force does not distinguish contact from flight.
    """
    values = np.asarray(force.values, float)
    firm = np.percentile(values, 95)
    free = np.percentile(values, 2)
    if threshold is None and not firm > 5 * max(abs(free), 1e-12):
        raise RecordError(
            f"from {free:.3g} in flight to {firm:.3g} in firm contact, which are not clearly apart; subtract the "
            "offset of the sensor, or give --threshold"
        )
    high, low = (HIGH * firm, LOW * firm) if threshold is None else (threshold, threshold / 3)
    state = np.where(values > high, 1, np.where(values < low, 0, -1))
    known = np.flatnonzero(state >= 0)
    if not len(known):
        return np.zeros(len(values), bool)
    last = known[np.clip(np.searchsorted(known, np.arange(len(values)), "right") - 1, 0, None)]
    return state[last] == 0


def crossings(signal: Signal, level: float, falling: bool) -> list[float]:
    """Times at which a signal passes a level in one direction, interpolated linearly.

    It must have been on the other side by a tenth of the signal's range (5th to 95th percentile) since the last
    crossing, so that noise at the level gives no further ones.
    """
    values = (np.asarray(signal.values, float) - level) * (-1 if falling else 1)
    low, high = np.percentile(values, [5, 95])
    below = max(0.1 * float(high - low), 8 * rounding_of(values))  # it may rest for nearly all the time
    armed = False
    found = []
    for number in range(1, len(values)):
        armed |= bool(values[number - 1] < -below)
        if armed and values[number] >= 0:
            before = values[number - 1]
            after = values[number]
            share = float(-before / (after - before)) if before < 0 else 0.0
            found.append(float(signal.time[number - 1] + share * (signal.time[number] - signal.time[number - 1])))
            armed = False
    return found


def _glitch(edges: Sequence[float], kinds: Sequence[bool]) -> int | None:
    """Number of the shortest phase that is a glitch, among those with a phase before and after."""
    durations = np.diff(edges)
    typical = _typical(edges, kinds)
    inner = range(1, len(kinds) - 1)
    shortest = min(inner, key=lambda number: durations[number] / typical[kinds[number]], default=None)
    if shortest is None or durations[shortest] >= GLITCH * typical[kinds[shortest]]:
        return None
    return shortest


def _typical(edges: Sequence[float], kinds: Sequence[bool]) -> dict[bool, float]:
    """Typical duration of the phases of both kinds."""
    durations = np.diff(edges)
    of_kind = np.array(kinds)
    found = {}
    for kind in (False, True):
        sorted_durations = np.sort(durations[of_kind == kind])
        total = np.cumsum(sorted_durations)
        found[kind] = float(sorted_durations[np.searchsorted(total, total[-1] / 2)]) if len(total) else 1.0
    return found
