"""Compilation of code that is not in the cache yet: when it begins, which takes a while, and errors of the cache."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from traceback import extract_tb

from numba.core.event import Event, Listener, install_listener

from stepgap.base.compiled import cache_folder


class _FirstCompilation(Listener):
    """Calls a function when Numba compiles for the first time."""

    def __init__(self, callback: Callable[[], None]):
        self._callback, self._called = callback, False

    def on_start(self, event: Event) -> None:  # noqa: ARG002  (the signature is Numba's)
        if not self._called:
            self._called = True
            self._callback()

    def on_end(self, event: Event) -> None:
        """Does nothing; Numba requires it."""


@contextmanager
def on_first_compilation(callback: Callable[[], None]) -> Iterator[None]:
    """Calls `callback` at the first compilation within the block; never if all code comes from the cache."""
    with install_listener("numba:compile", _FirstCompilation(callback)):
        yield


@contextmanager
def naming_cache() -> Iterator[None]:
    """Adds the cache folder to errors of the operating system that Numba raises there, such as that of a full disk.

    Raises:
        OSError: The error raised inside.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None and "numba" in Path(extract_tb(error.__traceback__)[-1].filename).parts:
            error.filename = str(cache_folder())
        raise
