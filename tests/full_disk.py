"""Simulation of a full disk, for tests of the error messages."""

import resource
import sys
from collections.abc import Iterator
from contextlib import contextmanager

FILE_TOO_LARGE = "File too large"


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Limits the size of files that this process writes [bytes]; as on a full disk, the error names no file.

    Meanwhile no bytecode is written: Python would leave the first bytes of a module, which no later import can read.
    """
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    bytecode, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = bytecode
