"""A table of the columns of a log, whatever the format of its file."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, time, timedelta
from difflib import get_close_matches
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

LARGEST_VALUE = 1e12  # Largest magnitude of a number that is accepted as a measurement
MOST_NUMBERS = 2**25  # Largest number of values, rows times columns, that is read from one log

MOST_ELEMENTS = 100
"""Longest list in a row whose elements become columns; longer ones, such as pictures, are left out."""

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)

LogColumn = NDArray[np.float64] | NDArray[np.str_]
"""A column of a log: numbers, or labels."""


@final
@dataclass(frozen=True, eq=False)
class LogTable:
    """Columns of numbers of one log.

    Attributes:
        source: Text for error messages: the file, and the topic or group where it has several.
        columns: Columns by name, all of one length R: numbers, NaN where one is missing, or labels (text).
        lines: Line numbers of the rows, for messages; None for binary formats.
        heading: Text for messages about the names of columns; empty where it is the same as `source`.
        repeated: Names that more than one column has, which are not in `columns`; those of text are NAME[0], NAME[1], …
        unread: Parts of the file that were left out, each with the reason: a topic, a column, or GROUP:COLUMN.
    """

    source: str
    columns: Mapping[str, LogColumn]
    lines: NDArray[np.intp] | None = None
    heading: str = ""
    repeated: frozenset[str] = field(default=frozenset())
    unread: Mapping[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        """Number of rows R."""
        return len(next(iter(self.columns.values()), ()))

    def row(self, index: int) -> str:
        """Text for error messages about a row."""
        return f"{self.source}, " + (f"row {index + 1}" if self.lines is None else f"line {self.lines[index]}")

    def fault_of(self, column: str) -> str:
        """Why there is no such column, empty if there is; the name that was probably meant."""
        if column in self.columns:
            return ""
        return self.known_fault_of(column) or unknown_column(column, list(self.columns))

    def known_fault_of(self, column: str) -> str:
        """Why a column of the file is not in the table; empty if the file has no such column."""
        if column in self.repeated:
            first = f"{column}[0]"
            return "more than one such column" + (f"; the first is {first!r}" if first in self.columns else "")
        for part, reason in self.unread.items():
            names = {part, part.rpartition(":")[2]}
            if column in names or any(column.startswith((f"{name}:", f"{name}[", f"{name}.")) for name in names):
                return f"{part} was left out: {reason}"
        return ""

    def numbers(self, column: str, factor: float = 1.0) -> Array:
        """The numbers of a column times a factor; shape (R,).

        Raises:
            RecordError: There is no such column, or a value is no measurement; the message names its row.
        """
        if fault := self.fault_of(column):
            raise RecordError(f"{self.heading or self.source}: {fault}")
        values: Any = self.columns[column]
        right = f"a number within ±{LARGEST_VALUE:g}, such as 0.5, or empty"
        if values.dtype.kind == "U":
            numbers = list(map(number_in, values.tolist()))
            if None in numbers:
                index = numbers.index(None)
                if re.match(r"\d+([./-]\d+)+[ T]|\d+:\d", values[index]):
                    right = "a number; as a time (--time) it must be like 2024-05-01 12:00:00.5 or 01.05.2024 12:00:00"
                raise self._wrong(column, index, right)
            values = np.array(numbers, float)
        scaled = values * factor
        if (wrong := np.abs(scaled) > LARGEST_VALUE).any():
            hint = "; [factors] of --columns may give its factor, such as 1e-9 for a time in ns"
            raise self._wrong(column, int(wrong.argmax()), right + hint)
        return scaled

    def times(self, column: str, factor: float = 1.0) -> Array:
        """The times in a column [s]: numbers times a factor, or text that `seconds_in` reads; shape (R,).

        Raises:
            RecordError: As of `numbers`, or only some cells are such text.
        """
        values: Any = self.columns.get(column, np.zeros(0))
        cells = values.tolist() if values.dtype.kind == "U" else []
        first = next((cell for cell in cells if cell.lower() not in MISSING), "")
        if seconds_in(first) is None:
            return self.numbers(column, factor)
        seconds = [np.nan if cell.lower() in MISSING else seconds_in(cell) for cell in cells]
        if None in seconds:
            raise self._wrong(column, seconds.index(None), f"a time such as {first:.40}, or empty")
        return np.array(seconds, float)

    def _wrong(self, column: str, index: int, right: str) -> RecordError:
        shown = _shown(self.columns[column][index])
        return RecordError(f"{self.row(index)}, column {column!r}: {shown!r:.40}; it must be {right}")


MISSING = {"", "na", "n/a", "nan", "null", "none", "inf", "-inf"}
"""Contents of a cell, in lower case, that mean a missing number."""


def number_in(cell: str) -> float | None:
    """The number in a cell, NaN if it is missing; None if the cell holds something else."""
    if cell.lower() in MISSING:
        return np.nan
    try:
        return None if "_" in cell else float(cell)
    except ValueError:
        return None


_GERMAN = re.compile(r"^(\d\d)\.(\d\d)\.(\d{4})(?=[ T])")
"""A date as day.month.year."""


def seconds_in(cell: str) -> float | None:
    """The time in a cell [s]; None if it holds something else.

    It is a date and a time as in ISO 8601, or day.month.year and a time, counted from 1970 and in UTC unless there is a
    zone; or a time of the day.
    """
    cell = _GERMAN.sub(r"\3-\2-\1", cell)
    try:
        moment = datetime.fromisoformat(cell)
    except ValueError:
        try:
            moment = datetime.combine(_EPOCH, time.fromisoformat(cell))
        except ValueError:
            return None
    return ((moment if moment.tzinfo else moment.replace(tzinfo=UTC)) - _EPOCH) / timedelta(seconds=1)


def column_of_cells(cells: list[str]) -> LogColumn | None:
    """The numbers in cells, or labels where one is no number; None where these would take too much memory."""
    numbers = list(map(number_in, cells))
    if None not in numbers:
        return np.array(numbers, float)
    longest = max(map(len, cells))
    return np.array(cells, np.str_) if longest * len(cells) <= MOST_NUMBERS else None


def check_size(source: str, values: float) -> None:
    """Raises RecordError if a log holds too many values."""
    if not values <= MOST_NUMBERS:
        raise RecordError(f"{source}: {values:.4g} values, rows times columns; at most {MOST_NUMBERS} are read")


def _shown(value: Any) -> str:
    return str(value) if isinstance(value, str) else f"{value:.6g}".replace("e+", "e")


def unknown_column(name: str, names: Sequence[str]) -> str:
    """Message about an unknown column, with the name that was probably meant."""
    close = get_close_matches(name, names, n=1, cutoff=0.5)
    return f"no column {name!r}; " + (f"did you mean {close[0]!r}?" if close else f"there is {', '.join(names):.300}")
