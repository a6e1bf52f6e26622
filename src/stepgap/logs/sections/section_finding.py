"""The sections of a log: times at which a step ends and the next one begins."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import final

import numpy as np

from stepgap.logs.sections.aerial_phases import AerialPhase, aerial_phases, airborne, crossings
from stepgap.logs.sections.section_settings import BOOM_COLUMNS, NEXT_FOOT, SectionSettings
from stepgap.logs.sections.signals import Signal, SignalLog, TimedTable
from stepgap.logs.sections.tops import tops
from stepgap.logs.tables.log_table import LogTable
from stepgap.records.steps_csv import RecordError

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
        found = _tops(log, settings)
    elif settings.rule == "crossing":
        signal = log.signal(settings.crossing)
        times = crossings(signal, settings.level, settings.falling)
        std = signal.interval / np.sqrt(12)
        found = [FoundSection(time, time_std=std) for time in times]
    elif settings.at == NEXT_FOOT:
        found = _next_feet(log, settings)
    else:
        found = _in_flights(flights(log, settings), log, settings)
    if len(found) < 2:
        raise RecordError(
            f"{log.source}: the rule {settings.rule} finds {len(found)} section(s); at least two are needed"
            + (WALKING if (settings.contact or settings.force) and settings.at != NEXT_FOOT else "")
        )
    return found


def _tops(log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    try:
        return [FoundSection(time) for time in tops(log.signal(settings.height_column), settings.rise)]
    except RecordError as error:
        raise RecordError(f"{log.source}, column {settings.height_column!r}: {error}") from None


def with_boom(log: SignalLog, settings: SectionSettings) -> SignalLog:
    """The log with the columns `height` and `forward`, if the robot hops around a boom.

    Raises:
        RecordError: There is no such angle.
    """
    if not settings.boom:
        return log
    pitch = log.signal(settings.pitch)
    yaw = log.signal(settings.yaw)
    columns = (np.sin(np.asarray(pitch.values, float)), np.asarray(yaw.values, float))
    tables = [
        TimedTable(LogTable(f"{log.source}, boom", {name: settings.boom * values}), angle.time)
        for name, values, angle in zip(BOOM_COLUMNS, columns, (pitch, yaw), strict=True)
    ]
    factors = {column: factor for column, factor in log.factors.items() if column not in BOOM_COLUMNS}
    return replace(log, files=[tables, *log.files], factors=factors)


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
        swings += [(each, number) for each in aerial_phases(foot.time, np.asarray(foot.values) == 1)]
    swings.sort(key=lambda swing: swing[0].end)
    others = [foot != (swings[row - 1][1] if row else None) for row, (_, foot) in enumerate(swings)]
    return [
        FoundSection(swing.end, swing.begin, swing.end, swing.resolution / np.sqrt(12), swing.doubts)
        for (swing, _), other in zip(swings, others, strict=True)
        if other
    ]


def _in_flights(found: Sequence[AerialPhase], log: SignalLog, settings: SectionSettings) -> list[FoundSection]:
    """The sections of flights."""
    whole = [
        FoundSection(each.begin, each.begin, each.end, each.resolution / np.sqrt(12), each.doubts) for each in found
    ]
    if settings.at == "begin":
        return whole
    if settings.at == "end":
        return [replace(each, time=each.end) for each in whole]
    height = log.signal(settings.height_column)
    sections = list[FoundSection]()
    rises = list[float]()
    for each in whole:
        part = height.between(each.begin, each.end)
        if not len(part):
            sections.append(
                replace(each, time=(each.begin + each.end) / 2, doubts=(*each.doubts, "no height in this flight"))
            )
            rises.append(np.nan)
            continue
        top = int(np.argmax(part.values))
        sections.append(replace(each, time=float(part.time[top]), time_std=0.0))
        rises.append(float(part.values[top] - part.values[[0, -1]].astype(float).min()))
    low = 0.2 * float(np.nanmedian(rises)) if np.isfinite(rises).any() else 0.0
    return [
        replace(each, doubts=(*each.doubts, "the height hardly rises")) if rise < low else each
        for each, rise in zip(sections, rises, strict=True)
    ]
