"""Standard output and the lines on stderr: warnings, and the announcement of compilation."""

import errno
import os
import sys
from collections.abc import Callable, Sequence
from functools import wraps
from io import TextIOWrapper
from pathlib import Path
from typing import Any, TextIO, TypeGuard

from stepgap.base.errors import InputError

STOPPED = 130  # Exit code after Ctrl-C, as in shells


def warn(message: str) -> None:
    """Prints one line on stderr."""
    print(f"stepgap: {printable(message)}", file=sys.stderr)


def printable(text: str) -> str:
    """A text, also one with names from files of others, as a line that can only be read by a terminal, not obeyed.

    Control characters, such as those that begin a command to the terminal or turn the direction of writing, become
    escapes as in Python.
    """
    line = " ".join(text.split())
    return "".join(letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in line)


def replace_unwritable_characters() -> None:
    """Lets standard output write `?` for a character that its encoding, such as ASCII or Latin-1, does not have."""
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":
        sys.stdout.reconfigure(errors="replace")


def flush_output() -> None:
    """Writes what standard output has buffered; at the end of the program an error could not be explained any more."""
    if sys.stdout is not None:  # a shell can close it
        sys.stdout.flush()


def is_output_error(error: Exception) -> TypeGuard[OSError]:
    """Whether standard output cannot be written: its disk is full, or nobody reads it any more.

    Errors of all other files name them, because they are written within `naming` or `naming_cache`.
    """
    unwritable = (errno.ENOSPC, errno.EFBIG, errno.EPIPE)
    return isinstance(error, OSError) and error.errno in unwritable and error.filename is None


def discard_output() -> None:
    """Discards standard output; what it could not write is otherwise tried again at the end of the program."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def is_watched(stream: TextIO) -> bool:
    """Whether a person looks at a stream that can be drawn again: a terminal, but not that of a notebook.

    A notebook runs programs in a terminal of its own and asks for colours by `FORCE_COLOR`, but it keeps every frame
    of a bar as a further output.
    """
    return stream.isatty() and "JPY_PARENT_PID" not in os.environ and os.environ.get("TERM") != "dumb"


def open_page(page: Path) -> None:
    """Opens a file in the browser, or says why it does not: a browser of a terminal would take its lines."""
    import webbrowser

    displays = ("DISPLAY", "WAYLAND_DISPLAY", "BROWSER")
    if sys.platform != "darwin" and not any(os.environ.get(name) for name in displays):
        warn("--open: there is no display here (DISPLAY is not set); open the report in a browser elsewhere")
    elif not webbrowser.open(page.resolve().as_uri()):
        warn("--open: no browser opened the report; BROWSER in the environment names one")


def check_consent(asked_by: str) -> None:
    """Ensures that a person can consent to torque: standard input is a terminal, not a pipe or a file.

    Args:
        asked_by: Option or verb that gives torque.

    Raises:
        InputError: It is not.
    """
    if sys.stdin is None or not sys.stdin.isatty():
        raise InputError(
            f"{asked_by}: standard input is not a terminal; torque needs a person at the keyboard, not a pipe"
        )


def announces_compilation(verb: Callable[..., None]) -> Callable[..., None]:
    """Decorator of a verb that may compile: it says so on stderr, unless quiet, and errors of the cache name it.

    On a terminal it says every few seconds how far it is.
    """

    @wraps(verb)
    def announcing(*arguments: Any, **options: Any) -> None:
        from stepgap.base.compiling import naming_cache, on_compilation, signals_between_passes

        def announce(functions: int, seconds: float) -> None:
            if _is_quiet(options):
                return
            if not functions:
                warn("compiling for this machine, once; this takes about half a minute")
            elif is_watched(sys.stderr):
                warn(f"compiling: {functions} functions after {seconds:.0f} s")

        with naming_cache(), on_compilation(announce), signals_between_passes():
            verb(*arguments, **options)

    return announcing


def _is_quiet(options: dict[str, Any]) -> bool:
    """Whether `--quiet` is given among the options or in a group of them."""
    return any(getattr(option, "quiet", False) for option in options.values()) or bool(options.get("quiet"))


def print_table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Prints a table with columns side by side."""
    widths = [max(len(row[column]) for row in [heads, *rows]) for column in range(len(heads))]
    for row in [heads, *rows]:
        print("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())
