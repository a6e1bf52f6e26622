"""Files that are complete at every moment, and errors that name the file they are about."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Adds the name of a file to operating-system errors that name none, such as that of a full disk.

    Raises:
        OSError: The error raised inside; its `filename` is `path` unless it was set.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def write_whole(path: Path, content: str | bytes) -> None:
    """Writes a file atomically: a reader finds the old or the new content, never a part, even after a crash.

    Its folder is created if it is missing.

    Raises:
        OSError: It cannot be written; the old file, if there is one, is unchanged.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    partial.unlink(missing_ok=True)  # so that nothing is written through a link with this name
    with naming(path):
        try:
            with partial.open("xb") as file:
                file.write(content.encode("utf-8") if isinstance(content, str) else content)
                file.flush()
                os.fsync(file.fileno())
        except OSError:
            partial.unlink(missing_ok=True)  # a part of the content would only fill the disk
            raise
        partial.replace(path)
