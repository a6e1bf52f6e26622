"""A disk that nothing waits for: tests write some ten thousand steps, and each would wait until it is on the disk."""

import os
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from _typeshed import FileDescriptorLike


def leave_out_waiting_for_the_disk() -> None:
    """From now on this process and its copies do not wait; only a loss of power could tell the difference.

    Tests of when something is on the disk put a function of their own in this place.
    """
    os.fsync = _checked


def _checked(file: "FileDescriptorLike") -> None:
    """Raises what `os.fsync` raises for what is no open file."""
    os.fstat(file if isinstance(file, int) else file.fileno())
