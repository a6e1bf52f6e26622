"""CSV files of points of a step map, and of their next states."""

import csv
from io import StringIO
from pathlib import Path

import numpy as np

from stepgap.base.files import read_bounded_text
from stepgap.control.reference import numbers_in_row
from stepgap.step import Array, Outcome, StepSpace, StepStatus

LARGEST_POINTS_FILE = 2**28
"""Largest file of points that is read [bytes]."""


def read_points(path: Path, space: StepSpace) -> Array:
    """States and commands from a CSV file: a header of their names in any order, one point a row, SI units.

    Returns:
        Shape (rows, n + m), in the order of `space`.

    Raises:
        ValueError: The message names file, line and column, and states what is valid.
    """
    names = list(space.names)
    wanted = f"it must be a CSV file with the columns {','.join(names)}"
    try:
        text = read_bounded_text(path, LARGEST_POINTS_FILE)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}; {wanted}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: this is not text; {wanted}") from None
    rows = csv.reader(StringIO(text, newline=""), strict=True)
    try:
        header = [cell.strip() for cell in next(rows, [])]
        if sorted(header) != sorted(names):
            raise ValueError(f"{path}, line 1: the header is {','.join(header)!r:.80}; it must be {','.join(names)!r}")
        quantities = {quantity.name: quantity for quantity in (*space.state, *space.command)}
        columns = [quantities[name] for name in header]
        points = [numbers_in_row(row, columns, f"{path}, line {rows.line_num}") for row in rows if row]
    except csv.Error as error:
        raise ValueError(f"{path}, line {rows.line_num}: {error}; {wanted}") from None
    if not points:
        raise ValueError(f"{path}, line 2: there is no point; it must have at least one row below the header")
    return np.array(points)[:, [header.index(name) for name in names]]


def outcome_rows(space: StepSpace, points: Array, outcome: Outcome) -> str:
    """Formats points, their next states (NaN where there is none) and status as CSV; numbers are exact to the bit."""
    names = [*space.names, *(f"next_{name}" for name in space.state_names), "status"]
    numbers = np.hstack([points, outcome.next_state]).tolist()
    statuses = [StepStatus(code).label for code in outcome.status.tolist()]
    rows = [",".join([*map(repr, row), status]) for row, status in zip(numbers, statuses, strict=True)]
    return "\n".join([",".join(names), *rows]) + "\n"
