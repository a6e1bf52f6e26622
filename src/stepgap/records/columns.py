"""Which columns of a CSV file hold what of a step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.settings_file import read_toml
from stepgap.records.steps_csv import MOST_COORDINATES, RecordError
from stepgap.step import Array, Quantity, StepSpace

LARGEST_VALUE = 1e12
"""Numbers beyond are no measurements."""

ROLES = ("state", "next", "command", "target", "predicted")
"""What the columns of a step hold, coordinate by coordinate."""


@dataclass(frozen=True)
class Columns:
    """Which columns of a CSV file hold what; a row is a step.

    A column is given by its name, or as NAME=COLUMN to call its coordinate NAME. If only one of `state` and `next` is
    given, rows chain: the state after a step is the state before the one in the following row.

    Attributes:
        state: State before the step.
        next: State after it.
        command: Command of the step. Without it `target` stands for it: a controller without memory makes the
            command of state and target.
        target: State wanted after the step.
        predicted: Next state as the nominal map predicted it.
        deployment: Column that tells deployments apart, within which rows chain; empty for one deployment.
        step: Column that numbers the steps; rows chain only where it goes up by one. Empty if there is none.
        units: Units of columns, after their factors.
        factors: What to multiply columns by.
    """

    state: tuple[str, ...] = ()
    next: tuple[str, ...] = ()
    command: tuple[str, ...] = ()
    target: tuple[str, ...] = ()
    predicted: tuple[str, ...] = ()
    deployment: str = ""
    step: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    factors: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not (self.state or self.next):
            raise ValueError("state: no column; name those of the state before the step, or as next those after it")
        if not (self.command or self.target):
            raise ValueError("command: no column; name those of the command, or of the target that stands for it")
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
        for column, factor in self.factors.items():
            if not 1 / LARGEST_VALUE <= abs(factor) <= LARGEST_VALUE:
                raise ValueError(f"factors: {column} = {factor}, but it must be a number of ordinary size, not zero")
        names = [name_of(entry) for entry in (*self.inputs[0], *self.inputs[1])]
        if len(set(names)) < len(names):
            raise ValueError(f"state and command: {','.join(names)}; give each a name of its own, as NAME=COLUMN")

    @property
    def inputs(self) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """What gives the state and the command their names."""
        return self.state or self.next, self.command or self.target

    @property
    def numbers(self) -> dict[str, str]:
        """The columns of numbers, each with what it is read for."""
        named = {column_of(entry): role for role in ROLES for entry in getattr(self, role)}
        return named | ({self.step: "step"} if self.step else {})

    def space(self, state: Array, command: Array) -> StepSpace:
        """Names and units, with the ranges of these data; shapes (N, n) and (N, m)."""
        quantities = [
            tuple(
                _quantity(name_of(entry), self.units.get(column_of(entry), ""), values)
                for entry, values in zip(entries, data.T, strict=True)
            )
            for entries, data in zip(self.inputs, (state, command), strict=True)
        ]
        return StepSpace(*quantities)


def read_columns(file: Path | None, options: Mapping[str, str]) -> Columns | None:
    """What a TOML file with the attributes of `Columns` says, overridden by options; None if nothing is said.

    Args:
        file: The file.
        options: Names of columns, separated by commas, by attribute.

    Raises:
        RecordError: Naming file and key, or option, and what would be right.
    """
    said = _read_table(file) if file else {}
    for key, text in options.items():
        names = tuple(name.strip() for name in text.split(",")) if key in ROLES else (text.strip(),)
        if not all(names):
            raise RecordError(f"--{key} {text!r:.60}: a name is empty; give names of columns, separated by commas")
        said[key] = names if key in ROLES else names[0]
    if not said:
        return None
    try:
        return Columns(**said)
    except ValueError as error:
        raise RecordError(f"{f'{file}: ' if file else '--'}{error}") from None


def _read_table(file: Path) -> dict[str, Any]:
    """The table of a TOML file, checked for names and types."""
    try:
        table = read_toml(file, "a file of columns")
    except InputError as error:
        raise RecordError(str(error)) from None
    return {key: _checked(key, value, file) for key, value in table.items()}


def _checked(key: str, value: Any, file: Path) -> Any:
    """A value of the file, if it has the type of the attribute."""
    known = [entry.name for entry in fields(Columns)]
    if key in ROLES:
        fits, right = isinstance(value, list) and all(map(_is_name, value)), "a list of names of columns"
    elif key in ("deployment", "step"):
        fits, right = _is_name(value), "the name of a column"
    elif key == "units":
        fits, right = _is_table(value, str), "a table of texts, by column"
    elif key == "factors":
        fits, right = _is_table(value, int | float), "a table of numbers, by column"
    else:
        close = get_close_matches(key, known, n=1)
        hint = f"did you mean {close[0]}?" if close else f"the keys are {', '.join(known)}"
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
    """A coordinate with the range of its values, or one around them where they are all alike."""
    lower, upper = float(values.min()), float(values.max())
    margin = 0.0 if lower < upper else max(abs(lower), 1.0)
    return Quantity(name, unit, lower - margin, upper + margin)


def unknown_column(name: str, known: Sequence[str]) -> str:
    """Says which column was probably meant."""
    close = get_close_matches(name, known, n=1, cutoff=0.5)
    return f"no column {name!r}; " + (f"did you mean {close[0]!r}?" if close else f"there is {', '.join(known):.300}")


def column_of(entry: str) -> str:
    """The column of COLUMN or NAME=COLUMN."""
    return entry.partition("=")[2] or entry


def name_of(entry: str) -> str:
    """What the coordinate of COLUMN or NAME=COLUMN is called."""
    return entry.partition("=")[0] or entry
