"""Tells when Numba compiles: what is not in the cache yet takes its time."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core.event import Event, Listener, install_listener


class _Teller(Listener):
    """Calls a function when Numba begins to compile for the first time."""

    def __init__(self, tell: Callable[[], None]):
        self._tell, self._told = tell, False

    def on_start(self, event: Event) -> None:  # noqa: ARG002  (the signature is Numba's)
        if not self._told:
            self._told = True
            self._tell()

    def on_end(self, event: Event) -> None:
        pass


@contextmanager
def telling_of_compilation(tell: Callable[[], None]) -> Iterator[None]:
    """Calls `tell`, once, as soon as Numba compiles within; not while all that is called comes from the cache."""
    with install_listener("numba:compile", _Teller(tell)):
        yield
