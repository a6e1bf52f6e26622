"""A disk that takes no more, for tests of what is said then."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager

SAYS = "File too large"


@contextmanager
def largest_file(size: int) -> Iterator[None]:
    """Lets this process write no file beyond a size [bytes]: the system's error names no file, as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
