"""Termination by a signal as by Ctrl-C, so that clean-up code runs."""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

LOST_TERMINAL = tuple(getattr(signal, name) for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name))
"""Signals that a terminal sends to all its programs: when it is closed, and for a key; Windows has neither."""

ENDING = (signal.SIGTERM, *LOST_TERMINAL)  # Signals that end a program

PAUSING = tuple(getattr(signal, name) for name in ("SIGTSTP",) if hasattr(signal, name))
"""Signals with which a terminal stops all its programs until they are continued (Ctrl-Z); Windows has none."""


@contextmanager
def terminated_as_interrupted() -> Iterator[None]:
    """Lets the signals of `ENDING` raise KeyboardInterrupt within the block, as Ctrl-C does, in the main thread."""
    with handled(_interrupt):
        yield


@contextmanager
def handled(
    handler: Callable[[int, FrameType | None], None], numbers: tuple[signal.Signals, ...] = ENDING
) -> Iterator[None]:
    """Handles signals within the block, in the main thread; those that are ignored remain ignored.

    `nohup` starts a program with SIGHUP ignored.
    """
    if current_thread() is not main_thread():
        yield
        return
    before = {number: signal.getsignal(number) for number in numbers}
    wanted = [number for number in numbers if before[number] != signal.SIG_IGN]
    for number in wanted:
        signal.signal(number, handler)
    try:
        yield
    finally:
        for number in wanted:
            signal.signal(number, before[number])


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raises KeyboardInterrupt; a lost terminal, of which kernel and shell both notify the program, does so once.

    A second KeyboardInterrupt would end the landing of a robot.
    """
    if number == getattr(signal, "SIGHUP", None):
        signal.signal(number, signal.SIG_IGN)
    signal.default_int_handler(number, frame)
