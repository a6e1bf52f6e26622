"""The command line.

At their top, verb modules import only modules that load quickly, so that help does not wait; a test checks this.

Exit codes: 0 done; 2 bad input, with one line that gives the rule; 130 Ctrl-C; 1 any other failure.
"""

import os
import re
import sys
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from inspect import signature
from itertools import pairwise
from typing import Any

import cyclopts
from cyclopts import App

from stepgap.base.errors import InputError, StepGapError, StepGapWarning, message_of
from stepgap.cli.terminal import (
    STOPPED,
    discard_output,
    flush_output,
    is_output_error,
    printable,
    replace_unwritable_characters,
    warn,
)
from stepgap.cli.verbs import check_not_gone, command_line

OVERRIDE = re.compile(r"--(robot|[a-z_][a-z0-9_-]*\.[a-z0-9_.-]+)(?:=(.*))?", re.DOTALL)

_BAD_INPUT = 2  # Exit code where the user gave wrong input
_FAILED = 1  # Exit code of any other failure


def main(arguments: Sequence[str] | None = None, verbs: Callable[[str], App] = command_line) -> None:
    """Runs a command and exits with its code.

    Args:
        arguments: The command line without the program; None for that of this process.
        verbs: The verbs, given the first word of the command line.
    """
    replace_unwritable_characters()
    arguments, program = split_program(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    try:
        with _warnings_as_lines():
            run_words([argument for argument in arguments if argument != "--debug"], program, verbs)
    except KeyboardInterrupt as interrupt:
        warn(f"stopped{interrupt}")
        sys.exit(STOPPED)
    except Exception as error:
        if debug:
            raise
        if _is_interrupted(error):
            warn("stopped")
            sys.exit(STOPPED)
        line, code = _explained(error)
        warn(line)
        if is_output_error(error):
            discard_output()
        sys.exit(code)


def _is_interrupted(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused the error; while a module of C is imported, Python turns it into an ImportError."""
    while error and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def run_words(arguments: Sequence[str], program: list[str], verbs: Callable[[str], App]) -> None:
    """Parses a command line and calls its verb.

    Raises:
        InputError: The verb takes no settings or runs no other command, but some were given; or something is gone.
    """
    tokens, overrides = split_overrides(arguments)
    check_not_empty(tokens)
    check_not_gone(tokens)
    app = verbs(tokens[0] if tokens else "")
    verb, bound, ignored = app.parse_args(tokens, exit_on_error=False, print_error=False)
    if "overrides" in ignored:
        bound.arguments["overrides"] = overrides
    elif overrides:
        raise InputError(f"--{overrides[0][0]}: this command takes no settings")
    if "program" in ignored:
        bound.arguments["program"] = program
    elif program:
        raise InputError(f"-- {program[0]}: this command runs no other program")
    try:
        verb(*bound.args, **bound.kwargs)
    except SystemExit:  # of a verb with an exit code of its own
        flush_output()
        raise
    flush_output()


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Shows each warning of StepGap once, as one line on stderr; names of files in those of others are escaped."""
    show_other = warnings.showwarning
    shown = set[str]()

    def show(message: Warning | str, category: type[Warning], *place: Any) -> None:
        if not issubclass(category, StepGapWarning):
            show_other(printable(str(message)), category, *place)
        elif str(message) not in shown:
            shown.add(str(message))
            warn(str(message))

    with warnings.catch_warnings():
        warnings.simplefilter("always", StepGapWarning)  # also where the environment turns warnings into errors
        warnings.showwarning = show
        yield


def _is_bad_input(error: Exception) -> bool:
    """Whether the user gave wrong input, or a file or folder without permission to use it."""
    forbidden = isinstance(error, PermissionError) and error.filename is not None
    return forbidden or isinstance(error, InputError | cyclopts.CycloptsError)


def _explained(error: Exception) -> tuple[str, int]:
    """Message of an error and exit code; an unexpected exception in a plug-in is bad input, named by file and line."""
    explained = isinstance(error, StepGapError | OSError | cyclopts.CycloptsError)
    unexpected = None if explained else error
    if isinstance(error, StepGapError):
        unexpected = error.__cause__
    if unexpected:
        from stepgap.cli.plugin_errors import location_in_plugin

        if location := location_in_plugin(unexpected):
            return f"{location}: {_line_of(error)} (--debug shows the calls that led there)", _BAD_INPUT
    return _line_of(error), _BAD_INPUT if _is_bad_input(error) else _FAILED


def _line_of(error: Exception) -> str:
    """Message of an error, with its type if neither StepGap nor the system explains it."""
    if isinstance(error, cyclopts.UnusedCliTokensError) and error.unused_tokens:
        hint = "--help shows those of this command; the program of a robot goes after --"
        return f"{' '.join(error.unused_tokens)}: too many arguments; {hint}"
    if is_output_error(error):
        return f"standard output: {error.strerror}"
    about_a_file = isinstance(error, OSError) and error.filename is not None
    if _is_bad_input(error) or about_a_file or isinstance(error, StepGapError):
        return f"{message_of(error)}{_hint(error)}"
    text = error.args[0] if isinstance(error, KeyError) and error.args else error  # str(KeyError) is in quotes
    return f"{type(error).__name__}: {text}{_hint_of_numba()}"


def _hint_of_numba() -> str:
    """Hint that the environment changes how code is compiled, which may be why it fails; empty if it does not."""
    names = ", ".join(sorted(name for name in os.environ if name.startswith("NUMBA_") and name != "NUMBA_CACHE_DIR"))
    return f" (the environment sets {names}; try without)" if names else ""


def _hint(error: Exception) -> str:
    """Hint that an unknown option may be a setting, if the verb takes settings."""
    if not isinstance(error, cyclopts.UnknownOptionError) or "Did you mean" in str(error):
        return ""
    if not error.target or "overrides" not in signature(error.target).parameters:
        return ""
    return " If it is a setting, name its table as well, as in --parameters.body_mass 1.6."


def split_program(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Separates a command line given after `--` from the arguments before it."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    return list(arguments[:end]), list(arguments[end + 1 :])


def check_not_empty(tokens: Sequence[str]) -> None:
    """Refuses empty values: that of a variable of the shell that is not set would name the current folder.

    Raises:
        InputError: An argument, or the value of an option, is empty.
    """
    for before, token in pairwise(("", *tokens)):
        if not token:
            raise InputError(f"{before if before.startswith('-') else 'an argument'}: empty; give a value")
        if re.fullmatch("--[^=]*=", token):
            raise InputError(f"{token.removesuffix('=')}: empty; give a value")


def split_overrides(arguments: Sequence[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Separates `--robot name`, `--table.key value` and `--table.key=value` from the other arguments.

    Raises:
        InputError: A setting has no value.
    """
    others = []
    overrides = []
    remaining = list(arguments)
    while remaining:
        argument = remaining.pop(0)
        match = OVERRIDE.fullmatch(argument)
        if not match:
            others.append(argument)
        elif match[2] is not None:
            overrides.append((match[1], match[2]))
        elif remaining and not remaining[0].startswith("--"):
            overrides.append((match[1], remaining.pop(0)))
        else:
            raise InputError(f"{argument}: give a value")
    return others, overrides
