"""The signals of a log: columns with the times of their samples, from one file or from several that belong together."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import final

import numpy as np

from stepgap.logs.columns import unknown_column
from stepgap.logs.tables.files import LARGEST_LOG
from stepgap.logs.tables.log_table import LogColumn, LogTable
from stepgap.logs.tables.reading import read_log_tables, with_topic
from stepgap.logs.tables.text_format import AS_FOUND, TextFormat
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

TIMES = ("time", "log_time", "t", "timestamp")
"""Names of the column of the time, where none is given; the first one that a table has is used."""


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
    """

    source: str
    files: Sequence[Sequence[TimedTable]]
    factors: Mapping[str, float]

    @property
    def columns(self) -> list[str]:
        """Names of the columns of all tables."""
        return list(dict.fromkeys(name for file in self.files for one in file for name in one.table.columns))

    def signal(self, column: str) -> Signal:
        """The numbers of a column, from the first file that has it.

        Raises:
            RecordError: There is no such column, several tables of that file have it, or it does not contain numbers.
        """
        found = self._find(column)
        values = found.table.numbers(column) * self.factors.get(column, 1.0)
        known = np.isfinite(found.time) & np.isfinite(values)
        if known.sum() < 2:
            raise RecordError(f"{found.table.source}, column {column!r}: {known.sum()} numbers; at least 2 are needed")
        return Signal(found.time[known], values[known])

    def labels(self, column: str) -> Signal:
        """A column as text, such as the names of phases; a number as 3 or 0.5. Errors as of `signal`."""
        found = self._find(column)
        values = found.table.columns[column]
        if values.dtype.kind == "f":
            values = np.array([f"{value:.15g}" if np.isfinite(value) else "" for value in values.tolist()], np.str_)
        known = np.isfinite(found.time) & (values != "")
        return Signal(found.time[known], values[known])

    def _find(self, column: str) -> TimedTable:
        for tables in self.files:
            having = [one for one in tables if not one.table.fault_of(column)]
            if len(having) > 1:
                sources = ", ".join(one.table.source for one in having)
                raise RecordError(f"{sources:.300}: all have a column {column!r}; give it as TABLE:COLUMN")
            if having:
                return having[0]
        faults = (one.table.known_fault_of(column) for file in self.files for one in file)
        raise RecordError(f"{self.source}: {next(filter(None, faults), unknown_column(column, self.columns))}")


def read_signal_log(text: str, time: str, factors: Mapping[str, float], written: TextFormat = AS_FOUND) -> SignalLog:
    """Reads a log.

    Args:
        text: Path of a file; or several joined by "+", which have their own times, or else as many rows as the first.
        time: Column of the time; if empty, the first of `TIMES` that there is.
        factors: Factors by which columns are multiplied, for example 0.001 for a time in ms.
        written: How the numbers of text files are written.

    Raises:
        RecordError: A file cannot be read, has no time, or its times decrease.
    """
    paths = [Path(text)] if Path(text).exists() else [Path(part.strip()) for part in text.split("+")]
    files: list[list[TimedTable]] = []
    for path in paths:
        tables = read_log_tables(path, written, LARGEST_LOG)
        files.append(_with_times(path, tables, time, factors, files[0][0] if files else None))
    return SignalLog(text, files, factors)


def _with_times(
    path: Path, tables: Mapping[str, LogTable], name: str, factors: Mapping[str, float], first: TimedTable | None
) -> list[TimedTable]:
    """The tables that have a time, or as many rows as the first one, whose time then counts."""
    found: list[TimedTable] = []
    for topic, table in tables.items():
        column = next((one for one in ([name] if name else TIMES) if not table.fault_of(one)), None)
        if column is not None:
            time = _checked_times(table, column, factors.get(column, 1.0))
        elif first is not None and len(first.time) == len(table):
            time = first.time
        else:
            continue
        found.append(TimedTable(with_topic(topic, table), time))
    if found:
        return found
    wanted = repr(name) if name else f"named {', '.join(TIMES)}"
    rows = f", and not the {len(first.time)} rows of the first file" if first else ""
    columns = ", ".join(dict.fromkeys(column for table in tables.values() for column in table.columns))
    raise RecordError(f"{path}: no column of the time, {wanted}{rows}; name it by --time; there is {columns:.300}")


def _checked_times(table: LogTable, column: str, factor: float) -> Array:
    time = table.numbers(column) * factor
    known = np.flatnonzero(np.isfinite(time))
    back = np.flatnonzero(np.diff(time[known]) < 0)
    if len(back):
        before, after = known[back[0]], known[back[0] + 1]
        change = f"goes back from {time[before]:.6f} to {time[after]:.6f} s"
        raise RecordError(f"{table.row(int(after))}, column {column!r}: the time {change}; split the log there")
    return time
