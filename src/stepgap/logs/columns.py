"""The meaning of a log's columns: which of them hold the state, the command and the other parts of a step."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import tau
from pathlib import Path

from stepgap.base.names import UNIT_RULE, as_name, is_unit
from stepgap.base.settings_file import merge, read_toml
from stepgap.cli.options import ColumnNames
from stepgap.logs.tables.log_table import LARGEST_VALUE, unknown_column
from stepgap.logs.tables.text import AS_FOUND, TextFormat
from stepgap.records.steps_csv import MOST_COORDINATES
from stepgap.step import Array, ContextQuantity, Quantity, StepSpace

_ROUNDING = 1e-14  # Differences of numbers that are smaller than this part of them are rounding

ROLES = ("state", "next", "command", "target", "predicted")
"""Parts of a step that have one column per coordinate."""


@dataclass(frozen=True)
class Columns(ColumnNames):
    """The meaning of a log's columns; a row is a step.

    A column is given by its name, or as NAME=COLUMN to call its coordinate NAME; a name is made an identifier. If only
    one of `state` and `next` is given, rows are chained within a deployment: the state after a step is the state before
    the step of the following row. Without `command`, `target` is used instead, because a controller without memory
    computes the command from state and target. Without `step`, a step follows the one before it if it starts where that
    one ended.

    Attributes:
        units: Units of columns, after multiplication by their factors.
        factors: Factors by which columns are multiplied.
        format: How the numbers of a text file are written, where the file does not show it.
    """

    units: Mapping[str, str] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    format: TextFormat = AS_FOUND

    def __post_init__(self) -> None:
        if not (self.state or self.next):
            raise ValueError("state: no column; name the columns of the state before the step, or as next after it")
        if not (self.command or self.target):
            raise ValueError("command: no column; name the columns of the command, or of the target used instead")
        wanted = len(self.state or self.next)
        for role in ROLES:
            entries = getattr(self, role)
            count = len(entries)
            if not all(map(column_of, entries)):
                raise ValueError(f"{role} = {','.join(entries)!r:.60}, but it must be names, and none may be empty")
            if role != "command" and count not in (0, wanted):
                raise ValueError(f"{role}: {count} columns; it must have as many as the state, which has {wanted}")
            if count > MOST_COORDINATES:
                raise ValueError(f"{role}: {count} columns; it must have at most {MOST_COORDINATES}")
        numbers = list(self.numbers)
        for table in ("units", "factors"):
            for column in getattr(self, table):
                if column not in numbers:
                    raise ValueError(f"{table}: {unknown_column(column, numbers)}")
        check_units(self.units, self.factors)
        names = [name_of(entry) for entry in (*self.inputs[0], *self.inputs[1])]
        if len(set(names)) < len(names):
            raise ValueError(f"state and command: {','.join(names)}; give each a different name, as NAME=COLUMN")

    @property
    def inputs(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """Entries that name the coordinates of the state and of the command."""
        return self.state or self.next, self.command or self.target

    @property
    def numbers(self) -> dict[str, str]:
        """Numeric columns, each with the part of a step that it holds."""
        named = {column_of(entry): role for role in ROLES for entry in getattr(self, role)}
        return named | {column: role for column, role in ((self.step, "step"), (self.yaw, "yaw")) if column}

    def space(self, state: Array, command: Array) -> StepSpace:
        """Step space with the names, the units and the ranges of these data; shapes (N, n) and (N, m)."""
        state_quantities, command_quantities = (
            tuple(
                _quantity(name_of(entry), self.units.get(column_of(entry), ""), values)
                for entry, values in zip(entries, data.T, strict=True)
            )
            for entries, data in zip(self.inputs, (state, command), strict=True)
        )
        context = (ContextQuantity("yaw", "rad", period=tau),) if self.yaw else ()
        return StepSpace(state_quantities, command_quantities, context)


def check_units(units: Mapping[str, str], factors: Mapping[str, float]) -> None:
    """Raises ValueError if one of the units or factors of columns is no unit, or no factor."""
    for column, unit in units.items():
        if not is_unit(unit):
            raise ValueError(f"units.{column} = {unit!r:.60}, but it must {UNIT_RULE}")
    for column, factor in factors.items():
        if not 1 / LARGEST_VALUE <= abs(factor) <= LARGEST_VALUE:
            raise ValueError(f"factors.{column} = {factor}, but its magnitude must lie between 1e-12 and 1e12")


def read_columns(file: Path | None, options: Mapping[str, str | tuple[str, ...]]) -> Columns | None:
    """Reads `Columns` from a TOML file and from options by attribute, which override it; None if neither gives any.

    Raises:
        InputError: An entry is wrong; the message names file and key, or option, and the rule.
    """
    table = read_toml(file, "a file of columns") if file else {}
    table |= {key: list(value) if isinstance(value, tuple) else value for key, value in options.items()}
    if not table:
        return None

    def locate(key: str) -> str:
        return f"--{key}" if key in options or not file else f"{file}: {key}"

    # Keys are checked together, since some depend on others; the start has what is required.
    start = Columns(state=("state",), command=("command",))
    return merge(start, {"state": [], "command": []} | table, locate)


def _quantity(name: str, unit: str, values: Array) -> Quantity:
    """Coordinate with the range of its values, or with a range around them where they are equal but for rounding."""
    lower = float(values.min())
    upper = float(values.max())
    largest = max(abs(lower), abs(upper))
    margin = 0.0 if upper - lower > max(_ROUNDING * largest, 1 / LARGEST_VALUE) else max(largest, 1.0)
    return Quantity(name, unit, lower - margin, upper + margin)


def column_of(entry: str) -> str:
    """The column in COLUMN or NAME=COLUMN."""
    return entry.partition("=")[2] or entry


def name_of(entry: str) -> str:
    """The name of the coordinate in COLUMN or NAME=COLUMN, as an identifier."""
    return as_name(entry.partition("=")[0] or entry)
