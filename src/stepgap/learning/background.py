"""Deferred values, which a background thread may compute early; the values are the same with and without it."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any, Generic, Self, TypeVar, final

T = TypeVar("T")


@final
class Deferred(Generic[T]):
    """A value that is computed once, at the first call of `result`.

    Args:
        compute: Returns the value; it must depend on constants only.
    """

    def __init__(self, compute: Callable[[], T]):
        self._compute: Callable[[], T] | None = compute
        self._lock = Lock()
        self._value: list[T] = []

    def result(self) -> T:
        """Returns the value; waits while another thread computes it."""
        with self._lock:
            if self._compute is not None:
                self._value.append(self._compute())
                self._compute = None  # so that the data it was computed from can be freed
            return self._value[0]

    def then(self, function: Callable[[T], T]) -> "Deferred[T]":
        """Applies a function to this value; the result is deferred, too."""
        return Deferred(lambda: function(self.result()))


@final
class BackgroundThread:
    """A thread that computes deferred values; use it as a context manager."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)

    def compute(self, deferred: Deferred[Any] | None) -> None:
        """Schedules a value for computation, after those scheduled before; None is ignored."""
        if deferred is not None:
            self._pool.submit(deferred.result)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pool.shutdown(cancel_futures=True)
