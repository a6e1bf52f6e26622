"""Simulation of a full disk, for tests of the error messages."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager

FILE_TOO_LARGE = "File too large"


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limits the size of files that this process writes [bytes]; as on a full disk, the error names no file."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
