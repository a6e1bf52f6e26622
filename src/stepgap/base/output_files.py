"""Output files of the verbs: no existing file is overwritten, and an error is one line."""

import os
from collections.abc import Collection, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from itertools import chain, count
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.files import create, removed_on_failure

PICTURE_FORMATS = ("pdf", "png", "svg")  # File formats of a figure

EXISTING_IS_COMPLETE = " (one that StepGap wrote is complete)"
"""What is true of each output that exists: it gets its name when it is complete, also if a process is killed."""


def format_by_name(path: Path, formats: Collection[str] = PICTURE_FORMATS) -> str:
    """File format that the end of a name demands.

    Raises:
        InputError: It is none of the formats.
    """
    if (form := path.suffix[1:].lower()) not in formats:
        raise InputError(f"{path}: the name must end with one of .{', .'.join(formats)}")
    return form


def check_new(path: Path, option: str) -> None:
    """Raises InputError where a file would be overwritten or cannot be written."""
    if os.path.lexists(path):
        raise InputError(f"{path}: exists already; choose another {option}{EXISTING_IS_COMPLETE}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: no folder to write in; choose another {option}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: cannot be written: Permission denied; choose another {option}")


@contextmanager
def writing(path: Path, option: str) -> Iterator[None]:
    """Turns an error of the file system into an InputError of one line that names the file."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another {option}") from None


def write_new(path: Path, option: str, content: str | bytes) -> None:
    """Writes a new file and prints its path; where it cannot be written completely, there is none."""
    write_together({path: content}, option)


def write_together(contents: Mapping[Path, str | bytes], option: str) -> None:
    """Writes new files and prints their paths; where one of them cannot be written completely, there is none."""
    with ExitStack() as written:
        for path, content in contents.items():
            with writing(path, option):
                create(path, content)
            written.enter_context(removed_on_failure(path))
    for path in contents:
        print(path)


def free_name(path: Path) -> Path:
    """The first of NAME.SUFFIX, NAME_2.SUFFIX, … that does not exist."""
    names = chain([path], (path.with_stem(f"{path.stem}_{number}") for number in count(2)))
    return next(name for name in names if not os.path.lexists(name))  # also a link to nothing takes its name
