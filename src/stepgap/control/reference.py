"""The reference: the desired state at each step (Fig. 4), or the desired coordinates of it."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from io import StringIO
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from stepgap.base.files import read_bounded_text
from stepgap.step import Array, Quantity, StepSpace

Indices = NDArray[np.intp]
"""Row numbers of `Reference.targets`, from 0."""

LARGEST_REFERENCE = 2**20  # Largest file of a reference that is read [bytes]
SETTLING_STEPS = 4  # Steps after a change of the target that count as transient


@dataclass(frozen=True, eq=False, repr=False)
class Reference:
    """The targets of all steps of a deployment.

    Attributes:
        names: Names of the state coordinates; n of them.
        targets: State wanted at the end of each step, NaN in coordinates in which nothing is wanted, read-only; shape
            (steps, n), SI units.

    Raises:
        ValueError: There is no step or no target at all, the shape is wrong, or a target is infinite.
    """

    names: tuple[str, ...]
    targets: Array

    def __post_init__(self) -> None:
        targets = np.array(self.targets, float)
        if targets.ndim != 2 or targets.shape[0] == 0 or targets.shape[1] != len(self.names):
            raise ValueError(f"targets have shape {targets.shape}; it must be (steps, {len(self.names)}), steps ≥ 1")
        if np.isinf(targets).any():
            row, column = np.argwhere(np.isinf(targets))[0]
            raise ValueError(
                f"target of {self.names[column]} at step {row + 1} must be a finite number, or NaN for none"
            )
        if np.isnan(targets).all():
            raise ValueError("there is no target; at least one number must be wanted")
        targets.flags.writeable = False
        object.__setattr__(self, "targets", targets)

    def __repr__(self) -> str:
        ranges = [
            f"{name} {np.nanmin(column):g} to {np.nanmax(column):g}" if np.isfinite(column).any() else f"{name} free"
            for name, column in zip(self.names, self.targets.T, strict=True)
        ]
        return f"<Reference of {len(self)} steps: {', '.join(ranges)}>"

    @classmethod
    def from_segments(cls, names: Sequence[str], segments: Sequence[tuple[int, Sequence[float]]], steps: int) -> Self:
        """Builds a reference that is constant on each segment.

        Args:
            names: Names of the state coordinates; n of them.
            segments: Step at which each segment starts, counted from 1, and its state, n numbers.
            steps: Total number of steps.

        Raises:
            ValueError: The starts do not begin at step 1, do not increase, or lie beyond the last step.
        """
        starts = [start for start, _ in segments]
        if not starts or starts[0] != 1:
            raise ValueError(f"segments start at steps {starts}; the first must start at step 1")
        lengths = np.diff([*starts, steps + 1])
        if (lengths < 1).any():
            raise ValueError(f"segments start at steps {starts}; they must increase and not exceed {steps} steps")
        states = np.array([state for _, state in segments], float)
        return cls(tuple(names), np.repeat(states, lengths, axis=0))

    def __len__(self) -> int:
        return len(self.targets)

    def of(self, space: StepSpace) -> Self:
        """This reference with all state coordinates of a space: those that it lacks have no target.

        Raises:
            ValueError: It has a target of a coordinate that the space does not have, or does not track.
        """
        tracked = tuple(quantity.name for quantity in space.state if quantity.weight)
        targeted = [name for name, column in zip(self.names, self.targets.T, strict=True) if np.isfinite(column).any()]
        if others := sorted({*targeted} - {*tracked}):
            raise ValueError(f"the reference has targets of {','.join(others)}; the robot tracks {','.join(tracked)}")
        if self.names == space.state_names:
            return self
        targets = np.full((len(self), len(space.state)), np.nan)
        for name in targeted:
            targets[:, space.state_names.index(name)] = self.targets[:, self.names.index(name)]
        return type(self)(space.state_names, targets)

    @property
    def changes(self) -> Indices:
        """Steps whose target differs from that of the step before."""
        return np.flatnonzero(~same_target(self.targets[1:], self.targets[:-1])) + 1

    @property
    def mean_target(self) -> Array:
        """Mean of the targets from the first change on, before which a deployment starts; shape (n,), NaN for none."""
        return mean_of_known(self.targets[self.changes[0] if len(self.changes) else 0 :])

    @cached_property
    def distinct(self) -> tuple[Indices, Indices]:
        """First step with each distinct target, in ascending order of the targets, and which of them each step has."""
        return distinct_rows(self.targets)

    @property
    def transient(self) -> Indices:
        """The first `SETTLING_STEPS` steps from each change on, the changed step being the first."""
        age = self._age()
        return np.flatnonzero((age >= 0) & (age < SETTLING_STEPS))

    @property
    def steady(self) -> Indices:
        """Steps at least `SETTLING_STEPS` after the latest change.

        Steps before the first change do not count, since they include the start of the deployment, so a reference that
        never changes has none.
        """
        return np.flatnonzero(self._age() >= SETTLING_STEPS)

    def _age(self) -> Indices:
        """Steps since the latest change, 0 at the change itself and -1 before the first; shape (steps,)."""
        steps = np.arange(len(self))
        changes = self.changes
        count = np.searchsorted(changes, steps, side="right")
        return np.where(count > 0, steps - np.append(0, changes)[count], -1)


def distinct_rows(rows: Array) -> tuple[Indices, Indices]:
    """First of each of the distinct rows (N, k), in ascending order, and which of them each row is; NaN equals NaN."""
    comparable = np.where(np.isnan(rows), np.inf, rows)
    _, first, number = np.unique(comparable, axis=0, return_index=True, return_inverse=True)
    return first, number.reshape(-1)


def same_target(one: Array, other: Array) -> NDArray[np.bool_]:
    """Whether targets are the same, also in that they want nothing; (…, n) and (…, n) to (…)."""
    return np.all((one == other) | (np.isnan(one) & np.isnan(other)), axis=-1)


def mean_of_known(values: Array) -> Array:
    """Means over the steps whose values, such as targets or errors, are finite; (N, n) to (n,), NaN without any."""
    finite = np.isfinite(values)
    count = finite.sum(axis=0)
    total = np.where(finite, values, 0.0).sum(axis=0)
    return np.divide(total, count, out=np.full(len(count), np.nan), where=count > 0)


def read_reference(path: str | Path, space: StepSpace) -> Reference:
    """Reads a CSV file in the form that `parse_reference` takes.

    Raises:
        ValueError: The content is not a reference for `space`; the message names file, line and column.
        OSError: The file cannot be read.
    """
    try:
        text = read_bounded_text(Path(path), LARGEST_REFERENCE)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: this is not text; a reference is a CSV file in UTF-8") from error
    return parse_reference(text, space, str(path))


def parse_reference(text: str, space: StepSpace, source: str = "reference") -> Reference:
    """Parses CSV text: a header of names of tracked coordinates, then one row per step, SI units.

    A coordinate without a column, and a step with an empty cell or nan in it, have no target. At the end, rows without
    any target are no steps.

    Args:
        text: The content.
        space: Its tracked coordinates may be columns, in any order.
        source: Name of the text in messages, usually its file name.

    Raises:
        ValueError: The message names the source, line and column, and states what is valid.
    """
    tracked = [quantity for quantity in space.state if quantity.weight]
    rows = parse_rows(text, tracked, source, "step", may_lack=True)
    if np.isnan(rows).all():
        raise ValueError(f"{source}: there is no target; it must have a number in at least one row")
    last = np.flatnonzero(np.isfinite(rows).any(axis=1))[-1]  # spreadsheets end with rows of empty cells
    return Reference(tuple(quantity.name for quantity in tracked), rows[: last + 1]).of(space)


def reference_text(reference: Reference) -> str:
    """Formats a reference as the CSV text that `parse_reference` reads; numbers are exact to the bit."""
    columns = np.flatnonzero(np.isfinite(reference.targets).any(axis=0))
    rows = [",".join(map(repr, target)) for target in reference.targets[:, columns].tolist()]
    return "\n".join([",".join(reference.names[column] for column in columns), *rows]) + "\n"


def parse_rows(text: str, quantities: Sequence[Quantity], source: str, item: str, may_lack: bool = False) -> Array:
    """Parses CSV text: a header of the names of quantities in any order, then rows of their numbers, SI units.

    Semicolons may separate them; then decimals may have a comma.

    Args:
        text: The content.
        quantities: The columns.
        source: Name of the text in messages.
        item: What a row is, for messages.
        may_lack: Whether columns and numbers may be missing; they are NaN.

    Returns:
        Shape (rows, columns), in the order of the quantities.

    Raises:
        ValueError: The message names the source, line and column, and states what is valid.
    """
    names = [quantity.name for quantity in quantities]
    delimiter = ","
    if ";" in text.partition("\n")[0]:  # spreadsheets in languages whose decimals have a comma
        delimiter = ";"
        text = text.replace(",", ".")
    rows = csv.reader(StringIO(text, newline=""), delimiter=delimiter, strict=True)
    try:
        header = [cell.strip() for cell in next(rows, [])]
        complete = sorted(header) == sorted(names)
        if not complete and not (may_lack and header and {*header} <= {*names} and len({*header}) == len(header)):
            some = "or some of them, " if may_lack and len(names) > 1 else ""
            raise ValueError(
                f"{source}, line 1: the header is {','.join(header)!r:.80}; it must be {','.join(names)!r}, {some}"
                "separated by commas"
            )
        columns = [quantities[names.index(name)] for name in header]
        numbers = [
            _numbers_in_row(row, columns, f"{source}, line {rows.line_num}", may_lack)
            for row in rows
            if any(map(str.strip, row)) or (may_lack and len(row) > 1)
        ]
    except csv.Error as error:
        raise ValueError(f"{source}, line {rows.line_num}: {error}; it must be CSV") from None
    if not numbers:
        raise ValueError(f"{source}, line 2: there is no {item}; it must have at least one row below the header")
    table = np.full((len(numbers), len(names)), np.nan)
    table[:, [names.index(name) for name in header]] = numbers
    return table


def _numbers_in_row(row: Sequence[str], quantities: Sequence[Quantity], source: str, may_lack: bool) -> list[float]:
    if len(row) != len(quantities):
        names = ",".join(quantity.name for quantity in quantities)
        raise ValueError(f"{source}: {len(row)} values; it must have {len(quantities)}, one for each of {names}")
    return [
        np.nan if may_lack and cell.strip().lower() in ("", "nan") else _number(cell, quantity, source)
        for cell, quantity in zip(row, quantities, strict=True)
    ]


def _number(cell: str, quantity: Quantity, source: str) -> float:
    """Parses the finite number in a cell."""
    try:
        value = float(cell)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        example = (quantity.lower + quantity.upper) / 2
        raise ValueError(
            f"{source}, column {quantity.name!r}: {cell.strip()!r:.40}; "
            f"it must be a finite number in {quantity.unit}, for example {example:g}"
        )
    return value
