"""Types of command-line options, and the function that adds a verb to the command line."""

import re
from collections.abc import Callable, Sequence
from inspect import signature
from typing import Annotated, Any

from cyclopts import App, Parameter, Token
from cyclopts.validators import Number

DEBUG_HELP = "--debug shows where an error arose."

SETTINGS_HELP = (
    "Any setting of an experiment can be given as --TABLE.KEY VALUE, such as --gains.stiffness 2400. "
    f"Tables: robot, gains, command, learning, gap; the experiment.toml of any run lists every key. {DEBUG_HELP}"
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

Port = Annotated[Integer, Parameter(validator=Number(gte=1, lt=2**16))]
"""Number of a TCP port."""

Flag = Annotated[bool, Parameter(show_default=False)]
"""Option without a value."""

Overrides = Annotated[list[tuple[str, str]] | None, Parameter(parse=False)]
"""Settings given as `--table.key value`."""

Program = Annotated[list[str] | None, Parameter(parse=False)]
"""A command line given after `--`."""


def add_verb(app: App, name: str, verb: Callable[..., None]) -> None:
    """Adds a function as a verb; its help is its docstring, with a note on settings if it takes any."""
    takes_settings = "overrides" in signature(verb).parameters
    app.command(verb, name=name, help_epilogue=SETTINGS_HELP if takes_settings else DEBUG_HELP)
