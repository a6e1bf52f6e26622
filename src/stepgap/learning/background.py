"""Values that a thread may compute before they are needed; they are the same whether one does or not."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from threading import Lock
from typing import Any, Generic, Self, TypeVar, final

T = TypeVar("T")


@final
class Deferred(Generic[T]):
    """A value that is computed once, by whoever asks for it first.

    Args:
        compute: Gives the value; it must depend on nothing that changes.
    """

    def __init__(self, compute: Callable[[], T]):
        self._compute: Callable[[], T] | None = compute
        self._lock = Lock()
        self._value: list[T] = []

    def result(self) -> T:
        """The value; while another thread computes it, this one waits."""
        with self._lock:
            if self._compute is not None:
                self._value.append(self._compute())
                self._compute = None  # so that what the value was made of can be freed
            return self._value[0]

    def then(self, function: Callable[[T], T]) -> "Deferred[T]":
        """The function's value of this one, deferred as well."""
        return Deferred(lambda: function(self.result()))


@final
class BackgroundThread:
    """One thread that computes deferred values; to be used as a context manager."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1)

    def compute(self, deferred: Deferred[Any] | None) -> None:
        """Starts to compute a value, after those that were given before; None is nothing to compute."""
        if deferred is not None:
            self._pool.submit(deferred.result)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self._pool.shutdown(cancel_futures=True)
