"""Results of commands, as seen by the shell, for tests."""

from collections.abc import Callable
from typing import NamedTuple


class CommandResult(NamedTuple):
    """Exit code and output of a command."""

    code: int
    out: str
    err: str


Command = Callable[..., CommandResult]


def refused(result: CommandResult, *parts: str) -> None:
    """Asserts that a command refused its input with one line that contains these parts."""
    assert result.code == 2, result
    assert result.out == ""
    assert result.err.startswith("stepgap: ")
    assert result.err.count("\n") == 1
    assert result.err.endswith("\n")
    assert "Traceback" not in result.err
    for part in parts:
        assert part in result.err
