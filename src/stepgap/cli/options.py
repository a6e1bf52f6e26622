"""Types of command-line options, and the function that adds a verb to the command line."""

import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from inspect import signature
from typing import Annotated, Any

from cyclopts import App, Parameter, Token
from cyclopts.validators import Number

DEBUG_HELP = "--debug shows where an error arose."

SETTINGS_HELP = (
    "--robot NAME chooses the robot, by default the hopper. Any setting of an experiment can be given as --TABLE.KEY "
    "VALUE, such as --learning.residual linear. Tables: weights, nominal, learning, control, process and those of the "
    f"robot, such as gap; `stepgap settings --robot NAME` prints every key with its meaning. {DEBUG_HELP}"
)

MOST_DIGITS = 30


def _to_integer(_: Any, tokens: Sequence[Token]) -> int:
    """Converts a token to an integer; Cyclopts itself would round 1.5 to 2."""
    text = tokens[0].value
    if not re.fullmatch(rf"[+-]?[0-9]{{1,{MOST_DIGITS}}}", text):
        raise ValueError(f'"{text:.40}" is not an integer')
    return int(text)


Integer = Annotated[int, Parameter(converter=_to_integer)]
"""Option with an integer value."""

Name = Annotated[str, Parameter(metavar="NAME")]
"""Option with a name as its value; NAME, and not STR, stands for it in the help."""

Note = Annotated[str, Parameter(metavar="TEXT")]
"""Option with a sentence as its value."""

Names = Annotated[str, Parameter(metavar="NAMES")]
"""Option with names as its value, as NAME,NAME or as NAME=COLUMN,NAME=COLUMN."""


def _to_names(_: Any, tokens: Sequence[Token]) -> tuple[str, ...]:
    return tuple(name.strip() for name in tokens[0].value.split(","))


ListOfNames = Annotated[
    tuple[str, ...], Parameter(converter=_to_names, n_tokens=1, metavar="NAMES", show_default=False)
]
"""Option as `Names`, already divided."""

_ColumnName = Annotated[str, Parameter(metavar="NAME", show_default=False)]

NamedValues = Annotated[str, Parameter(metavar="NAME=VALUE,…")]
"""Option with values of quantities; `records.text.values_by_name` reads them."""

FileName = Annotated[str, Parameter(metavar="FILE")]
"""Option with a file as its value, as it is written into the settings."""

FolderName = Annotated[str, Parameter(metavar="FOLDER")]
"""Option with a folder as its value, as it is written into the settings."""

Address = Annotated[str, Parameter(metavar="ADDRESS")]
"""Option with an address of the network as its value."""

Seconds = Annotated[float, Parameter(metavar="SECONDS")]
"""Option with a time as its value."""

Port = Annotated[Integer, Parameter(validator=Number(gte=1, lt=2**16))]
"""Number of a TCP port."""

Flag = Annotated[bool, Parameter(show_default=False)]
"""Option without a value."""

Overrides = Annotated[list[tuple[str, str]] | None, Parameter(parse=False)]
"""Settings given as `--table.key value`."""

Program = Annotated[list[str] | None, Parameter(parse=False)]
"""A command line given after `--`."""


@Parameter(name="*")
@dataclass(frozen=True)
class ColumnNames:
    """Columns of a log that was not written by StepGap.

    Attributes:
        state: Columns of the state before the step, as NAME,NAME or as NAME=COLUMN,NAME=COLUMN.
        next: Columns of the state after the step. [default: those of the state in the following row]
        command: Columns of the command.
        target: Columns of the target; without --command they are used as the command.
        predicted: Columns of the nominal next state.
        deployment: Column that distinguishes deployments.
        step: Column that counts the steps; rows belong together where it increases by one.
        yaw: Column of the robot's yaw [rad], measured with the state.
    """

    state: ListOfNames = ()
    next: ListOfNames = ()
    command: ListOfNames = ()
    target: ListOfNames = ()
    predicted: ListOfNames = ()
    deployment: _ColumnName = ""
    step: _ColumnName = ""
    yaw: _ColumnName = ""

    def given(self) -> dict[str, str | tuple[str, ...]]:
        """The options that were given."""
        return {name: value for name, value in asdict(self).items() if value}


NO_COLUMNS = ColumnNames()


def add_verb(app: App, name: str, verb: Callable[..., Any]) -> None:
    """Adds a function as a verb, whose help is its docstring with a note on settings if it takes any; or an `App`."""
    if isinstance(verb, App):
        app.command(verb, name=name)
        return
    takes_settings = "overrides" in signature(verb).parameters
    app.command(verb, name=name, help_epilogue=SETTINGS_HELP if takes_settings else DEBUG_HELP)
