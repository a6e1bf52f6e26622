"""A table of the columns of a log, whatever the format of its file."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from stepgap.logs.columns import LARGEST_VALUE, unknown_column
from stepgap.records.steps_csv import RecordError
from stepgap.step import Array

MOST_NUMBERS = 2**25
"""Largest number of values, rows times columns, that is read from one log."""

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
        repeated: Names that more than one column has; these are not in `columns`.
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
            return "more than one such column"
        for part, reason in self.unread.items():
            names = {part, part.rpartition(":")[2]}
            if column in names or any(column.startswith((f"{name}:", f"{name}[", f"{name}.")) for name in names):
                return f"{part} was left out: {reason}"
        return ""

    def numbers(self, column: str) -> Array:
        """The numbers of a column; shape (R,).

        Raises:
            RecordError: There is no such column, or a value is no measurement; the message names its row.
        """
        if fault := self.fault_of(column):
            raise RecordError(f"{self.heading or self.source}: {fault}")
        values: Any = self.columns[column]
        if values.dtype.kind == "U":
            wrong = np.array([number_in(cell) is None for cell in values.tolist()], bool)
        else:
            wrong = np.abs(values) > LARGEST_VALUE
        if wrong.any():
            index = int(wrong.argmax())
            right = f"a number within ±{LARGEST_VALUE:g}, such as 0.5, or empty"
            raise RecordError(
                f"{self.row(index)}, column {column!r}: {_shown(values[index])!r:.40}; it must be {right}"
            )
        return values


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
