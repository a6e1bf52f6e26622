"""Files that are whole at every moment, and errors that name the file they are about."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Adds the name of a file to errors of the system that name none, such as that of a full disk.

    Raises:
        OSError: As it was raised inside; `filename` is `path` unless it was set.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def write_whole(path: Path, content: str | bytes) -> None:
    """Writes a file so that a reader, or a crash, sees the old one or the new one, never a part.

    The folder it lies in is made if it is missing.

    Raises:
        OSError: It cannot be written; the old file, if there is one, is as it was.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    partial.unlink(missing_ok=True)  # and not through a link that the folder may hold
    with naming(path):
        try:
            with partial.open("xb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            partial.unlink(missing_ok=True)  # on a full disk its part of the content is of no use
            raise
        partial.replace(path)


def append_text(path: Path, text: str) -> None:
    """Adds a text to the end of a file, which is made if it is missing.

    Raises:
        OSError: It cannot be written.
    """
    with naming(path), path.open("a", encoding="utf-8") as file:
        file.write(text)
