"""Compilation of code that is not in the cache yet: how far it is, signals meanwhile, and errors of the cache."""

import signal
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import current_thread, main_thread
from time import perf_counter
from traceback import extract_tb
from types import FrameType

from numba.core.event import Event, Listener, install_listener

from stepgap.base.compiled import cache_folder
from stepgap.base.signals import ENDING, handled

REPORT_INTERVAL = 5.0  # Time after which compilation is reported again [s]


class _Compilation(Listener):
    """Calls a function when Numba compiles for the first time, and from time to time later on."""

    def __init__(self, callback: Callable[[int, float], None]):
        self._callback = callback
        self._count = 0
        self._begin = 0.0
        self._last = 0.0

    def on_start(self, event: Event) -> None:  # noqa: ARG002  (the signature is Numba's)
        if not self._begin:
            self._begin = self._last = perf_counter()
            self._callback(0, 0.0)

    def on_end(self, event: Event) -> None:  # noqa: ARG002
        self._count += 1
        now = perf_counter()
        if now - self._last >= REPORT_INTERVAL:
            self._last = now
            self._callback(self._count, now - self._begin)


@contextmanager
def on_compilation(callback: Callable[[int, float], None]) -> Iterator[None]:
    """Calls a function with the number of compiled functions and the time since the first one began [s].

    It is called when the first one begins, then every `REPORT_INTERVAL`; never if all code comes from the cache.
    """
    with install_listener("numba:compile", _Compilation(callback)):
        yield


class _DelayedSignals(Listener):
    """Delays signals that Python handles, such as that of Ctrl-C, to the end of a pass of Numba in the main thread."""

    def __init__(self):
        self._passes = 0
        self._pending = list[int]()
        self._handled = ExitStack()

    def on_start(self, event: Event) -> None:  # noqa: ARG002  (the signature is Numba's)
        if current_thread() is not main_thread():
            return
        if self._passes == 0:
            numbers = tuple(number for number in (signal.SIGINT, *ENDING) if callable(signal.getsignal(number)))
            self._handled.enter_context(handled(self._delay, numbers))
        self._passes += 1

    def on_end(self, event: Event) -> None:  # noqa: ARG002
        if current_thread() is not main_thread():
            return
        self._passes -= 1
        if self._passes == 0 or self._pending:
            self._handled.close()  # the usual handlers are back
        while self._pending:
            signal.raise_signal(self._pending.pop(0))

    def _delay(self, number: int, frame: FrameType | None) -> None:  # noqa: ARG002
        self._pending.append(number)


@contextmanager
def signals_between_passes() -> Iterator[None]:
    """Delays signals that come while Numba compiles within the block by a pass, at most some seconds.

    LLVM calls Python back: an exception that a signal raises there would be lost, and the compiled code with it.
    """
    with install_listener("numba:run_pass", _DelayedSignals()):
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
