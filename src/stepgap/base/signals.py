"""Termination by a signal as by Ctrl-C, so that clean-up code runs."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Lets SIGTERM raise KeyboardInterrupt within the block, as Ctrl-C does; it acts in the main thread only."""
    if current_thread() is not main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
