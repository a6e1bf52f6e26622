"""What verbs write for the user: files that did not exist before, and one line where that cannot be."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stepgap.base.errors import InputError


def check_new(path: Path, option: str) -> None:
    """Raises InputError where a file would be overwritten or cannot be written."""
    if path.exists():
        raise InputError(f"{path}: exists already; choose another {option}")
    if not path.parent.is_dir():
        raise InputError(f"{path}: cannot be written: no folder to write in; choose another {option}")
    if not os.access(path.parent, os.W_OK):
        raise InputError(f"{path}: cannot be written: Permission denied; choose another {option}")


@contextmanager
def writing(path: Path, option: str) -> Iterator[None]:
    """Says in one line that a file could not be written."""
    try:
        yield
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}; choose another {option}") from None


def write_new(path: Path, option: str, content: str | bytes) -> None:
    """Writes a file that did not exist and says its name."""
    with writing(path, option), path.open("xb") as file:
        file.write(content.encode() if isinstance(content, str) else content)
    print(path)


def free_name(path: Path) -> Path:
    """The first of NAME.SUFFIX, NAME_2.SUFFIX, … that does not exist."""
    free, number = path, 1
    while free.exists():
        number += 1
        free = path.with_stem(f"{path.stem}_{number}")
    return free
