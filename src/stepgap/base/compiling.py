"""Detects when Numba compiles code that is not in the cache yet, which takes a while."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener


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
