"""Commands and targets of the steps of a log, matched by time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final, final

import numpy as np

from stepgap.logs.sections.clocks import TIMES
from stepgap.logs.sections.section_settings import SectionSettings
from stepgap.logs.sections.signals import Signal, SignalLog, divided
from stepgap.logs.tables.log_table import LogTable, unknown_column
from stepgap.logs.tables.reading import read_log_tables, with_topic
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

LEAD: Final = 0.1
"""A plan that is made up to this part of a step before a section is for the step that begins there."""

UNCLEAR: Final = 0.05  # A plan that is made closer than this part of a step to that limit is not used

SAMPLED: Final = 4
"""A signal with at least this number of samples for each step is sampled; one with fewer consists of plans."""

HELD: Final = (0.2, 0.8)  # Parts of a step between which a sampled command must not change


@final
@dataclass(frozen=True, eq=False)
class StepValues:
    """Values of one quantity for the steps between K sections.

    Attributes:
        values: One for each step; shape (K − 1,), NaN where there is none.
        doubts: Why there is none; empty texts where there is one.
    """

    values: Array
    doubts: tuple[str, ...]


def step_values(signal: Signal, sections: Array, of_several: str | None = None) -> StepValues:
    """The value of a signal for each step between successive sections.

    If the signal is sampled, this is the value that it holds in the middle of the step. Otherwise, its samples are
    plans, and a step has the one that was made during it.

    Args:
        sections: Times of the sections [s]; shape (K,).
        of_several: Which of several values counts, first, last or largest; None if they are doubtful.
    """
    inside = signal.between(float(sections[0]), float(sections[-1]))
    if len(inside) >= SAMPLED * (len(sections) - 1):
        return _held_values(signal, sections, of_several)
    return _planned_values(signal, sections, of_several)


def _chosen(values: Array, of_several: str | None) -> float:
    """One of several values in their order."""
    at = {"first": 0, "last": -1, "largest": int(np.abs(values).argmax())}[of_several or "first"]
    return float(values[at])


def _held_values(signal: Signal, sections: Array, of_several: str | None) -> StepValues:
    values = np.full(len(sections) - 1, np.nan)
    doubts = [""] * (len(sections) - 1)
    for number, (begin, end) in enumerate(pairwise(sections.tolist())):
        middle = signal.between(*(begin + share * (end - begin) for share in HELD))
        held = np.asarray(middle.values, float)
        if not len(held):
            doubts[number] = "no sample of the command"
        elif np.ptp(held) > 1e-6 * max(1.0, float(np.abs(held).max())) and not of_several:
            doubts[number] = "the command changes during the step"
        else:
            values[number] = _chosen(held, of_several)
    return StepValues(values, tuple(doubts))


def _planned_values(plans: Signal, sections: Array, of_several: str | None) -> StepValues:
    durations = np.diff(sections)
    planned: list[list[float]] = [[] for _ in durations]
    unclear = np.zeros(len(durations), bool)
    for time, value in zip(plans.time.tolist(), np.asarray(plans.values, float).tolist(), strict=True):
        # The step in which the plan is made, and the part of that which is over.
        step = int(np.searchsorted(sections, time, "right")) - 1
        nearest = int(np.clip(step, 0, len(durations) - 1))
        phase = (time - sections[nearest]) / durations[nearest]
        # It is for this step, or for the next one if that begins soon.
        number = int(np.floor(phase + LEAD)) + nearest
        if abs(phase % 1 - (1 - LEAD)) < UNCLEAR:
            unclear[[one for one in (nearest, nearest + 1) if one < len(durations)]] = True
        if 0 <= number < len(durations) and abs(number - nearest) <= 1:
            planned[number].append(value)
    values = np.full(len(durations), np.nan)
    doubts = [""] * len(durations)
    for number, made in enumerate(planned):
        if not made:
            doubts[number] = "no plan"
        elif len(made) > 1 and not of_several:
            doubts[number] = "several plans"
        elif unclear[number]:
            doubts[number] = "a plan between two steps"
        else:
            values[number] = _chosen(np.array(made), of_several)
    return StepValues(values, tuple(doubts))


@final
@dataclass(frozen=True, eq=False)
class Plans:
    """The plans of a log.

    Attributes:
        table: It has a row for each plan.
        time: Times at which they were made [s]; shape (P,).
        factors: Factors by which columns are multiplied.
    """

    table: LogTable
    time: Array
    factors: Mapping[str, float]

    def signal(self, column: str) -> Signal | None:
        """A column of numbers; None if there is no such column.

        Raises:
            RecordError: It contains something else.
        """
        if self.table.fault_of(column):
            return None
        values = self.table.numbers(column, self.factors.get(column, 1.0))
        complete = np.isfinite(self.time) & np.isfinite(values)
        order = np.argsort(self.time[complete], kind="stable")
        return Signal(self.time[complete][order], values[complete][order])


def read_plans(path: Path, log: SignalLog, settings: SectionSettings) -> Plans:
    """Reads the plans of a log, or of a single deployment in it.

    Raises:
        RecordError: The file cannot be read, has no times, or its rows are not found in the log.
    """
    tables = read_log_tables(path, settings.format)
    if len(tables) != 1:
        raise RecordError(f"{path}: {len(tables)} tables; plans must be one table")
    topic, table = next(iter(tables.items()))
    table = with_topic(topic, table)
    if log.deployment:
        parts = divided(table, settings.deployment)
        if log.deployment not in parts:
            raise RecordError(f"{path}: no plan of the deployment {log.deployment}")
        table = parts[log.deployment]
    if not settings.plan_match:
        given = settings.plan_time or settings.time
        wanted = [given] if given else list(TIMES)
        column = next((name for name in wanted if not table.fault_of(name)), None)
        if column is None:
            missing = unknown_column(wanted[0], list(table.columns))
            raise RecordError(f"{path}: {missing}; name the time of the plan by --plan-time, or use --plan-match")
        return Plans(table, table.times(column, settings.factors.get(column, 1.0)), settings.factors)
    own, _, other = settings.plan_match.partition("=")
    time = _matching_times(log.signal(other), table.numbers(own, settings.factors.get(own, 1.0)))
    if not np.isfinite(time).any():
        raise RecordError(f"{path}: no number of {own!r} occurs once in {other!r} of {log.source}")
    return Plans(table, time, settings.factors)


def _matching_times(signal: Signal, numbers: Array) -> Array:
    """Times at which a signal has the given numbers; NaN for a number that it never has, or in separate rows."""
    times = np.full(len(numbers), np.nan)
    for row, number in enumerate(numbers.tolist()):
        equal = np.flatnonzero(signal.values == number)
        if len(equal) and equal[-1] - equal[0] == len(equal) - 1:
            times[row] = signal.time[equal[0]]
    return times


def joined_doubts(parts: Sequence[StepValues]) -> list[str]:
    """For each step the first doubt about one of its values."""
    return [
        next((doubt for doubt in doubts if doubt), "") for doubts in zip(*(part.doubts for part in parts), strict=True)
    ]
