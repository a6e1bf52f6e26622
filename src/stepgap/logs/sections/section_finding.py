"""The sections of a log: times at which a step ends and the next one begins; among them those of flights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.section_settings import NEXT_FOOT, SectionSettings
from stepgap.logs.sections.signals import Signal, SignalLog, rounding_of
from stepgap.logs.sections.tops import tops
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

GLITCH: Final = 0.2  # A phase is a glitch if it is shorter than this part of a typical phase of its kind
SHORT_PHASE: Final = 0.4  # A phase is doubtful if it is shorter than this part of a typical phase of its kind

HIGH: Final = 0.3  # A foot touches down where its force exceeds this part of the force in firm contact,
LOW: Final = 0.1  # and lifts off below this part of it


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
    short = [bool(duration < SHORT_PHASE * typical[kind]) for duration, kind in zip(durations, kinds, strict=True)]
    resolution = float(np.median(np.diff(time)) or np.mean(np.diff(time)))
    phases: list[AerialPhase] = []
    for number in range(1, len(kinds) - 1):
        if kinds[number]:
            doubts = ["unusually short phase"] if short[number] else []
            doubts += ["unusually short interruption"] if short[number - 1] or short[number + 1] else []
            phases.append(AerialPhase(edges[number], edges[number + 1], resolution, tuple(doubts)))
    return phases


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
    samples = np.flatnonzero(state >= 0)
    if not len(samples):
        return np.zeros(len(values), bool)
    last = samples[np.clip(np.searchsorted(samples, np.arange(len(values)), "right") - 1, 0, None)]
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
    times = []
    for number in range(1, len(values)):
        armed |= bool(values[number - 1] < -below)
        if armed and values[number] >= 0:
            before = values[number - 1]
            after = values[number]
            share = float(-before / (after - before)) if before < 0 else 0.0
            times.append(float(signal.time[number - 1] + share * (signal.time[number] - signal.time[number - 1])))
            armed = False
    return times


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
    durations = np.diff(edges)
    of_kind = np.array(kinds)
    typical = {}
    for kind in (False, True):
        sorted_durations = np.sort(durations[of_kind == kind])
        total = np.cumsum(sorted_durations)
        typical[kind] = float(sorted_durations[np.searchsorted(total, total[-1] / 2)]) if len(total) else 1.0
    return typical


FLIGHT_WORDS = ("flight", "aerial", "swing")
"""Phases whose names contain one of these are those of flight, unless `aerial` says which are."""


@final
@dataclass(frozen=True)
class FoundSection:
    """A section as it was found, before its time and state are estimated.

    Attributes:
        time: Approximate time [s].
        begin: Time from which the motion about the section is smooth, such as lift-off [s]; −inf if unknown.
        end: Time until which it is smooth; inf if unknown.
        time_std: Standard deviation of the time [s]: that of an event between two samples; 0 where it is exact, or is
            estimated from the height.
        doubts: Why it may be none.
        since: Time at which the step that ends here began [s]; NaN if that is the section before.
    """

    time: float
    begin: float = -np.inf
    end: float = np.inf
    time_std: float = 0.0
    doubts: tuple[str, ...] = ()
    since: float = np.nan


WALKING = "; a robot that walks has no flight, in which all feet are in the air: use --at next_foot"
"""Advice where there are no flights."""

SectionFunction = Callable[[SignalLog], Sequence[FoundSection]]
"""Finds the sections of a log."""


def find_sections(log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    """Finds the sections by the rule of the settings.

    Raises:
        RecordError: A column is missing, or there are less than two sections.
    """
    if settings.rule == "height":
        sections = _tops(log, settings)
    elif settings.rule == "crossing":
        signal = log.signal(settings.crossing)
        times = crossings(signal, settings.level, settings.falling)
        std = signal.interval / np.sqrt(12)
        sections = [FoundSection(time, time_std=std) for time in times]
    elif settings.at == NEXT_FOOT:
        sections = _next_feet(log, settings)
    else:
        sections = _in_flights(flights(log, settings), log, settings)
    if len(sections) < 2:
        raise RecordError(
            f"{log.source}: the rule {settings.rule} finds {len(sections)} section(s); at least two are needed"
            + (WALKING if (settings.contact or settings.force) and settings.at != NEXT_FOOT else "")
        )
    return sections


def _tops(log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    try:
        return [FoundSection(time) for time in tops(log.signal(settings.height_column), settings.rise)]
    except RecordError as error:
        raise RecordError(f"{log.source}, column {settings.height_column!r}: {error}") from None


def flights(log: SignalLog, settings: SectionSettings) -> list[AerialPhase]:
    """The flights by phase, contact or force.

    Raises:
        RecordError: A column is missing, or flights cannot be determined from it.
    """
    if settings.rule == "phase":
        column = log.labels(settings.phase)
        names = _aerial_names(log.source, settings, sorted(set(column.values.tolist())))
        return aerial_phases(column.time, np.isin(column.values, names))
    columns = settings.contact or settings.force
    feet = [_in_air(log, column, settings) for column in columns]
    time = np.unique(np.concatenate([foot.time for foot in feet]))
    # Between its samples, a foot is as it was at the last one.
    latest = [np.clip(np.searchsorted(foot.time, time, "right") - 1, 0, None) for foot in feet]
    in_air = [foot.values[rows] == 1 for foot, rows in zip(feet, latest, strict=True)]
    return aerial_phases(time, np.all(in_air, axis=0))


def _in_air(log: SignalLog, column: str, settings: SectionSettings) -> Signal:
    """1 where a foot is in the air, else 0."""
    signal = log.signal(column)
    values = np.asarray(signal.values, float)
    if settings.rule == "force":
        try:
            return Signal(signal.time, airborne(signal, settings.threshold or None).astype(float))
        except RecordError as error:
            raise RecordError(f"{log.source}, column {column!r}: {error}") from None
    if not np.isin(values, (0, 1)).all():
        wrong = values[~np.isin(values, (0, 1))][0]
        raise RecordError(f"{log.source}, column {column!r}: {wrong:g}; a contact must be 0 or 1; use it as a --force")
    return Signal(signal.time, 1 - values)


def _aerial_names(source: str, settings: SectionSettings, labels: Sequence[str]) -> list[str]:
    if unknown := [name for name in settings.aerial if name not in labels]:
        raise RecordError(
            f"{source}, column {settings.phase!r}: no phase {unknown[0]!r}; there is {', '.join(labels):.200}"
        )
    names = list(settings.aerial) or [label for label in labels if any(word in label.lower() for word in FLIGHT_WORDS)]
    if not names:
        raise RecordError(
            f"{source}, column {settings.phase!r}: say by --aerial which are flight: {', '.join(labels):.200}"
        )
    return names


def _next_feet(log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    """Touch-downs of another foot than before; those of one foot in a row are one step."""
    swings: list[tuple[AerialPhase, int]] = []
    for number, column in enumerate(settings.contact or settings.force):
        foot = _in_air(log, column, settings)
        swings += [(phase, number) for phase in aerial_phases(foot.time, np.asarray(foot.values) == 1)]
    swings.sort(key=lambda swing: swing[0].end)
    others = [foot != (swings[row - 1][1] if row else None) for row, (_, foot) in enumerate(swings)]
    return [
        FoundSection(swing.end, swing.begin, swing.end, swing.resolution / np.sqrt(12), swing.doubts)
        for (swing, _), other in zip(swings, others, strict=True)
        if other
    ]


def _in_flights(phases: Sequence[AerialPhase], log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    whole = [
        FoundSection(phase.begin, phase.begin, phase.end, phase.resolution / np.sqrt(12), phase.doubts)
        for phase in phases
    ]
    if settings.at == "begin":
        return whole
    if settings.at == "end":
        return [replace(section, time=section.end) for section in whole]
    height = log.signal(settings.height_column)
    sections = list[FoundSection]()
    rises = list[float]()
    for section in whole:
        part = height.between(section.begin, section.end)
        if not len(part):
            middle = (section.begin + section.end) / 2
            sections.append(replace(section, time=middle, doubts=(*section.doubts, "no height in this flight")))
            rises.append(np.nan)
            continue
        top = int(np.argmax(part.values))
        sections.append(replace(section, time=float(part.time[top]), time_std=0.0))
        rises.append(float(part.values[top] - part.values[[0, -1]].astype(float).min()))
    low = 0.2 * float(np.nanmedian(rises)) if np.isfinite(rises).any() else 0.0
    return [
        replace(section, doubts=(*section.doubts, "the height hardly rises")) if rise < low else section
        for section, rise in zip(sections, rises, strict=True)
    ]
