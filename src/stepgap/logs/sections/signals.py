"""The signals of a log: columns with the times of their samples, from one file or from several that belong together."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.sections.clocks import LOGGED, TIMES, Clock, clock_of, rows_of
from stepgap.logs.tables.log_table import LogColumn, LogTable, unknown_column
from stepgap.logs.tables.reading import read_log_tables, with_topic
from stepgap.logs.tables.text import AS_FOUND, TextFormat
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array


@final
@dataclass(frozen=True, eq=False)
class Signal:
    """A signal that is sampled at R times, not necessarily at one rate; samples that are missing are left out.

    Attributes:
        time: Times [s], which do not decrease; shape (R,).
        values: Numbers or labels at these times; shape (R,).
    """

    time: Array
    values: LogColumn

    def __len__(self) -> int:
        """Number of samples R."""
        return len(self.time)

    def between(self, begin: float, end: float) -> "Signal":
        """The samples from one time to another, both included."""
        part = slice(int(np.searchsorted(self.time, begin)), int(np.searchsorted(self.time, end, "right")))
        return Signal(self.time[part], self.values[part])

    @property
    def interval(self) -> float:
        """Median time between successive samples [s]; infinite for less than two.

        Where most times are repeated, because they are rounded coarser than the samples are apart, it is the mean.
        """
        intervals = np.diff(self.time)
        return float(np.median(intervals) or np.mean(intervals)) if len(intervals) else np.inf


@final
@dataclass(frozen=True, eq=False)
class TimedTable:
    """A table and the time of each row [s]; shape (R,), NaN where it is missing."""

    table: LogTable
    time: Array


@final
@dataclass(frozen=True, eq=False)
class SignalLog:
    """The tables of a log.

    Attributes:
        source: Its files, for messages.
        files: The tables of each file.
        factors: Factors by which columns are multiplied.
        deployment: The deployment whose rows these are; empty if the log is not divided.
        clock: The column of the time, where messages have several clocks; otherwise empty.
        untimed: Tables without a time.
    """

    source: str
    files: Sequence[Sequence[TimedTable]]
    factors: Mapping[str, float]
    deployment: str = ""
    clock: str = ""
    untimed: Sequence[LogTable] = ()

    @property
    def columns(self) -> list[str]:
        """Names of the columns of all tables."""
        return list(dict.fromkeys(name for file in self.files for one in file for name in one.table.columns))

    def signal(self, column: str) -> Signal:
        """The numbers of a column, from the first file that has it.

        Raises:
            RecordError: There is no such column, several tables of that file have it, or it does not contain numbers.
        """
        timed = self._find(column)
        values = timed.table.numbers(column, self.factors.get(column, 1.0))
        complete = np.isfinite(timed.time) & np.isfinite(values)
        if complete.sum() < 2:
            where = f"{timed.table.source}, column {column!r}"
            raise RecordError(f"{where}: {complete.sum()} numbers; at least 2 are needed")
        return Signal(timed.time[complete], values[complete])

    def labels(self, column: str) -> Signal:
        """A column as text, such as the names of phases; a number as 3 or 0.5. Errors as of `signal`."""
        timed = self._find(column)
        values = _labels(timed.table, column)
        complete = np.isfinite(timed.time) & (values != "")
        return Signal(timed.time[complete], values[complete])

    def _find(self, column: str) -> TimedTable:
        for tables in self.files:
            having = [one for one in tables if not one.table.fault_of(column)]
            if len(having) > 1:
                sources = ", ".join(one.table.source for one in having)
                raise RecordError(f"{sources:.300}: all have a column {column!r}; give it as TABLE:COLUMN")
            if having:
                return having[0]
        for table in self.untimed:
            if not table.fault_of(column):
                names = ", ".join(table.columns)
                raise RecordError(
                    f"{table.source}: its {column!r} has no time; name it by --time; there is {names:.300}"
                )
        faults = (one.table.known_fault_of(column) for file in self.files for one in file)
        raise RecordError(f"{self.source}: {next(filter(None, faults), unknown_column(column, self.columns))}")


def read_signal_log(text: str, time: str, factors: Mapping[str, float], written: TextFormat = AS_FOUND) -> SignalLog:
    """Reads a log that is a single deployment.

    Args:
        text: Path of a file; or several joined by "+", which have their own times, or else as many rows as the first.
        time: Column of the time; if empty, the first of `TIMES` that there is.
        factors: Factors by which columns are multiplied, for example 0.001 for a time in ms.
        written: How the numbers of text files are written.

    Raises:
        RecordError: A file cannot be read, has no time, or its times decrease.
    """
    return _signal_log(text, [(path, read_log_tables(path, written)) for path in _paths(text)], time, factors)


def read_deployments(
    text: str, time: str, factors: Mapping[str, float], written: TextFormat, deployment: str
) -> list[Callable[[], SignalLog]]:
    """Reads a log, as `read_signal_log` does, that a column divides into deployments.

    Each is given by a function, so that one may be wrong. A table without the column has the deployments of the first
    file if it has as many rows.

    Raises:
        RecordError: A file cannot be read, or has no such column; as of `read_signal_log`, for each deployment.
    """
    files = [(path, read_log_tables(path, written)) for path in _paths(text)]
    logs: dict[str, list[tuple[Path, dict[str, LogTable]]]] = {}
    for path, tables in files:
        with_column = dict(_with_deployments(tables, files[0][1], deployment))
        if not with_column:
            raise RecordError(f"{path}: {next(iter(tables.values())).fault_of(deployment)}; it is to be the deployment")
        for topic, table in with_column.items():
            for name, part in divided(table, deployment).items():
                of_name = logs.setdefault(name, [])
                if not of_name or of_name[-1][0] != path:
                    of_name.append((path, {}))
                of_name[-1][1][topic] = part
    return [partial(_signal_log, text, parts, time, factors, name) for name, parts in logs.items()]


def _paths(text: str) -> list[Path]:
    return [Path(text)] if Path(text).exists() else [Path(part.strip()) for part in text.split("+")]


def divided(table: LogTable, column: str) -> dict[str, LogTable]:
    """The rows of a table by the labels in a column, in the order of their first rows; those without one are left out.

    Raises:
        RecordError: There is no such column.
    """
    if fault := table.fault_of(column):
        raise RecordError(f"{table.heading or table.source}: {fault}")
    names, number = np.unique(_labels(table, column), return_inverse=True)
    rows = np.split(np.argsort(number, kind="stable"), np.cumsum(np.bincount(number))[:-1])
    parts = sorted(zip(names.tolist(), rows, strict=True), key=lambda part: int(part[1][0])) if len(number) else []
    return {name: rows_of(table, part) for name, part in parts if name}


def _labels(table: LogTable, column: str) -> NDArray[np.str_]:
    values: Any = table.columns[column]
    if values.dtype.kind == "U":
        return values
    return np.array([f"{value:.15g}" if np.isfinite(value) else "" for value in values.tolist()], np.str_)


def _with_deployments(
    tables: Mapping[str, LogTable], first: Mapping[str, LogTable], column: str
) -> Iterator[tuple[str, LogTable]]:
    """Yields the tables that have the column of the deployment, or as many rows as one of the first file with it."""
    by_length = {len(table): table.columns[column] for table in first.values() if not table.fault_of(column)}
    for topic, table in tables.items():
        if not table.fault_of(column):
            yield topic, table
        elif len(table) in by_length:
            yield topic, replace(table, columns={**table.columns, column: by_length[len(table)]})


def _signal_log(
    text: str,
    files: Sequence[tuple[Path, Mapping[str, LogTable]]],
    time: str,
    factors: Mapping[str, float],
    deployment: str = "",
) -> SignalLog:
    clock = clock_of(text, [tables for _, tables in files], time, factors)
    timed: list[list[TimedTable]] = []
    untimed: list[LogTable] = []
    for path, tables in files:
        timed.append(_with_times(path, tables, clock, timed[0][0] if timed else None, untimed))
    clock.check_unit((one.table, one.time) for file in timed for one in file)
    source = f"{text}, {deployment}" if deployment else text
    is_messages = any(LOGGED in one.table.columns for file in timed for one in file)
    return SignalLog(source, timed, factors, deployment, clock.described if is_messages else "", untimed)


def _with_times(
    path: Path, tables: Mapping[str, LogTable], clock: Clock, first: TimedTable | None, untimed: list[LogTable]
) -> list[TimedTable]:
    """The tables that have a time, or as many rows as the first one, whose time then counts; others are `untimed`."""
    having: list[TimedTable] = []
    for topic, table in tables.items():
        timed = clock.timed(table)
        if timed is None and first is not None and len(first.time) == len(table):
            timed = table, first.time
        if timed is None:
            untimed.append(with_topic(topic, table))
        else:
            having.append(TimedTable(with_topic(topic, timed[0]), timed[1]))
    if having:
        return having
    wanted = repr(clock.name) if clock.name else f"named {', '.join(TIMES)}"
    rows = f", and not the {len(first.time)} rows of the first file" if first else ""
    columns = ", ".join(dict.fromkeys(column for table in tables.values() for column in table.columns))
    raise RecordError(f"{path}: no column of the time, {wanted}{rows}; name it by --time; there is {columns:.300}")


def rounding_of(values: Array) -> float:
    """What the largest of some values may be rounded by, in double precision; differences up to it mean nothing."""
    return float(np.finfo(float).eps * np.abs(values).max(initial=0.0))
