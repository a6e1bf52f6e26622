"""CSV files of points of a step map, and of their next states."""

from pathlib import Path

import numpy as np

from stepgap.base.files import read_bounded_text
from stepgap.control.reference import parse_rows
from stepgap.step import Array, Outcome, StepSpace, StepStatus

LARGEST_POINTS_FILE = 2**28  # Largest file of points that is read [bytes]


def read_points(path: Path, space: StepSpace) -> Array:
    """States and commands from a CSV file: a header of their names in any order, one point a row, SI units.

    Returns:
        Shape (rows, n + m), in the order of `space`.

    Raises:
        ValueError: The message names file, line and column, and states what is valid.
    """
    remedy = f"it must be a CSV file with the columns {','.join(space.names)}"
    try:
        text = read_bounded_text(path, LARGEST_POINTS_FILE)
    except OSError as error:
        raise ValueError(f"{path}: {error.strerror}; {remedy}") from None
    except UnicodeDecodeError:
        raise ValueError(f"{path}: this is not text; {remedy}") from None
    return parse_rows(text, (*space.state, *space.command), str(path), "point")


def outcome_rows(space: StepSpace, points: Array, outcome: Outcome) -> str:
    """Formats points, their next states (NaN where there is none) and status as CSV; numbers are exact to the bit."""
    names = [*space.names, *(f"next_{name}" for name in space.state_names), "status"]
    numbers = np.hstack([points, outcome.next_state]).tolist()
    statuses = [StepStatus(code).label for code in outcome.status.tolist()]
    rows = [",".join([*map(repr, row), status]) for row, status in zip(numbers, statuses, strict=True)]
    return "\n".join([",".join(names), *rows]) + "\n"
