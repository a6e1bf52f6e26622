"""Libraries that read binary formats: they are optional, and every error of theirs becomes one line about the file."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.base.versions import optional_package
from stepgap.records.steps_csv import RecordError


def library(name: str, path: Path, extra: str = "logs") -> Any:
    """A module of an optional package.

    Raises:
        RecordError: It is not installed; the message says which extra of this package installs it.
    """
    try:
        return optional_package(name, f"{path}: this format", extra)
    except InputError as error:
        raise RecordError(str(error)) from None


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turns any error of a library that reads untrusted bytes into one line.

    Raises:
        RecordError: An exception was raised inside; those that are a `RecordError` stay as they are.
    """
    try:
        yield
    except RecordError:
        raise
    except Exception as error:
        raise RecordError(f"{path}: not a readable {kind} file, damaged or incomplete ({cause_of(error)})") from None


@contextmanager
def leaving_out(part: str, unread: dict[str, str]) -> Iterator[None]:
    """Adds a part of a file to `unread`, with the reason, if it cannot be read.

    Raises:
        RecordError: One was raised inside: it is about the file as a whole.
    """
    try:
        yield
    except RecordError:
        raise
    except Exception as error:
        unread[part] = cause_of(error)


def cause_of(error: Exception) -> str:
    """One short line of an error."""
    return " ".join(str(error).split())[:120] or type(error).__name__
