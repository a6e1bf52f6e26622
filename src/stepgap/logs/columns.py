"""The meaning of a log's columns: which of them hold the state, the command and the other parts of a step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from math import tau
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.names import UNIT_RULE, as_name, is_unit
from stepgap.base.plugins import suggestion
from stepgap.base.settings_file import read_toml
from stepgap.logs.tables.text_format import AS_FOUND, TextFormat
from stepgap.records.steps_csv import MOST_COORDINATES, RecordError
from stepgap.step import Array, ContextQuantity, Quantity, StepSpace

LARGEST_VALUE = 1e12
"""Largest magnitude of a number that is accepted as a measurement."""

_ROUNDING = 1e-14
"""Differences of numbers that are smaller than this part of them are rounding."""

ROLES = ("state", "next", "command", "target", "predicted")
"""Parts of a step that have one column per coordinate."""


@dataclass(frozen=True)
class Columns:
    """The meaning of a log's columns; a row is a step.

    A column is given by its name, or as NAME=COLUMN to call its coordinate NAME; a name is made an identifier. If only
    one of `state` and `next` is given, rows are chained: the state after a step is the state before the step of the
    following row.

    Attributes:
        state: State before the step.
        next: State after the step.
        command: Command of the step. Without it `target` is used instead, because a controller without memory
            computes the command from state and target.
        target: Target state of the step.
        predicted: Next state as predicted by the nominal map.
        deployment: Column with the name or number of the deployment; rows are chained only within a deployment. Empty
            for a single deployment.
        step: Column with the number of the step; a step follows the one before it, and rows are chained, only where it
            increases by one. Empty if there is none; a step then follows if it starts where the one before it ended.
        yaw: Column with the yaw of the robot [rad], measured together with the state. Empty if there is none.
        units: Units of columns, after multiplication by their factors.
        factors: Factors by which columns are multiplied.
        format: How the numbers of a text file are written, where the file does not show it.
    """

    state: tuple[str, ...] = ()
    next: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    target: tuple[str, ...] = ()
    predicted: tuple[str, ...] = ()
    deployment: str = ""
    step: str = ""
    yaw: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)
    format: TextFormat = AS_FOUND

    def __post_init__(self) -> None:
        if not (self.state or self.next):
            raise ValueError("state: no column; name the columns of the state before the step, or as next after it")
        if not (self.command or self.target):
            raise ValueError("command: no column; name the columns of the command, or of the target used instead")
        for role in ROLES:
            count, wanted = len(getattr(self, role)), len(self.state or self.next)
            if role != "command" and count not in (0, wanted):
                raise ValueError(f"{role}: {count} columns; it must have as many as the state, which has {wanted}")
            if count > MOST_COORDINATES:
                raise ValueError(f"{role}: {count} columns; it must have at most {MOST_COORDINATES}")
        numbers = list(self.numbers)
        for table in ("units", "factors"):
            for column in getattr(self, table):
                if column not in numbers:
                    raise ValueError(f"{table}: {unknown_column(column, numbers)}")
        for column, unit in self.units.items():
            if not is_unit(unit):
                raise ValueError(f"units: {column} = {unit!r:.60}, but it must {UNIT_RULE}")
        for column, factor in self.factors.items():
            if not 1 / LARGEST_VALUE <= abs(factor) <= LARGEST_VALUE:
                raise ValueError(f"factors: {column} = {factor}, but its magnitude must lie between 1e-12 and 1e12")
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


def read_columns(file: Path | None, options: Mapping[str, str]) -> Columns | None:
    """Reads `Columns` from a TOML file and from options, which override the file; None if neither gives any.

    Args:
        file: The file.
        options: Names of columns, separated by commas, by attribute.

    Raises:
        RecordError: An entry is wrong; the message names file and key, or option, and the rule.
    """
    entries = _read_table(file) if file else {}
    for key, text in options.items():
        names = tuple(name.strip() for name in text.split(",")) if key in ROLES else (text.strip(),)
        if not all(names):
            raise RecordError(f"--{key} {text!r:.60}: a name is empty; give names of columns, separated by commas")
        entries[key] = names if key in ROLES else names[0]
    if not entries:
        return None
    try:
        entries["format"] = TextFormat(**entries.get("format", {}))
    except ValueError as error:
        raise RecordError(f"{file}: format.{error}") from None
    try:
        return Columns(**entries)
    except ValueError as error:
        raise RecordError(f"{f'{file}: ' if file else '--'}{error}") from None


def _read_table(file: Path) -> dict[str, Any]:
    """Reads the table of a TOML file and checks its names and types."""
    try:
        table = read_toml(file, "a file of columns")
    except InputError as error:
        raise RecordError(str(error)) from None
    return {key: _checked(key, value, file) for key, value in table.items()}


def _checked(key: str, value: Any, file: Path) -> Any:
    """Checks that a value of the file has the type of the attribute, and returns it."""
    known = [entry.name for entry in fields(Columns)]
    if key in ROLES:
        fits, right = isinstance(value, list) and all(map(_is_name, value)), "a list of names of columns"
    elif key in ("deployment", "step", "yaw"):
        fits, right = _is_name(value), "the name of a column"
    elif key == "units":
        fits, right = _is_table(value, str), "a table of strings, by column"
    elif key == "factors":
        fits, right = _is_table(value, int | float), "a table of numbers, by column"
    elif key == "format":
        keys = [entry.name for entry in fields(TextFormat)]
        fits, right = _is_table(value, str) and set(value) <= set(keys), f"a table of strings, {', '.join(keys)}"
    else:
        hint = suggestion(key, known) or f"the keys are {', '.join(known)}"
        raise RecordError(f"{file}: {key}: unknown key; {hint}")
    if not fits:
        raise RecordError(f"{file}: {key} = {value!r:.60}, but it must be {right}")
    return tuple(value) if key in ROLES else value


def _is_name(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def _is_table(value: object, wanted: Any) -> bool:
    return isinstance(value, dict) and all(
        isinstance(entry, wanted) and not isinstance(entry, bool) for entry in value.values()
    )


def _quantity(name: str, unit: str, values: Array) -> Quantity:
    """Coordinate with the range of its values, or with a range around them where they are equal but for rounding."""
    lower, upper = float(values.min()), float(values.max())
    largest = max(abs(lower), abs(upper))
    margin = 0.0 if upper - lower > max(_ROUNDING * largest, 1 / LARGEST_VALUE) else max(largest, 1.0)
    return Quantity(name, unit, lower - margin, upper + margin)


def unknown_column(name: str, known: Sequence[str]) -> str:
    """Message about an unknown column, with the name that was probably meant."""
    close = get_close_matches(name, known, n=1, cutoff=0.5)
    return f"no column {name!r}; " + (f"did you mean {close[0]!r}?" if close else f"there is {', '.join(known):.300}")


def column_of(entry: str) -> str:
    """The column in COLUMN or NAME=COLUMN."""
    return entry.partition("=")[2] or entry


def name_of(entry: str) -> str:
    """The name of the coordinate in COLUMN or NAME=COLUMN, as an identifier."""
    return as_name(entry.partition("=")[0] or entry)
