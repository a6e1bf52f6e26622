"""When a tick begins on the wall clock, and what a process asks of the kernel to be in time."""

import ctypes
import gc
import os
from collections.abc import Callable
from time import perf_counter, sleep

Pace = Callable[[], float]
"""Waits for the next tick's due time and says by how much it begins late [s]."""

SPIN = 1.5e-4
"""Time before a due time from which on the clock is watched instead of sleeping [s]."""

PRIORITY = 80
"""Of SCHED_FIFO; the kernel's interrupt threads have 50."""

MCL_CURRENT_AND_FUTURE = 3


class WallClock:
    """A `Pace` that sleeps until shortly before a due time, then spins.

    A tick that begins more than a period late moves all later ones: none is made up for.

    Args:
        period: Of a tick [s].
    """

    def __init__(self, period: float):
        self._period, self._due = period, perf_counter()

    def __call__(self) -> float:
        """Waits; how late it is [s]."""
        self._due += self._period
        left = self._due - perf_counter() - SPIN
        if left > 0:
            sleep(left)
        while (now := perf_counter()) < self._due:
            pass
        late = now - self._due
        if late > self._period:
            self._due = now
        return late


def ask_for_realtime() -> list[str]:
    """Asks for SCHED_FIFO and locked memory, and keeps the garbage collector away; says what was refused."""
    gc.collect()
    gc.freeze()
    gc.disable()
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except (AttributeError, PermissionError):
        refused.append("real-time scheduling (SCHED_FIFO) is refused: it needs root, CAP_SYS_NICE or an rtprio limit")
    try:
        locked = ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT_AND_FUTURE) == 0
    except (AttributeError, OSError):
        locked = False
    if not locked:
        refused.append("locked memory (mlockall) is refused: it needs root, CAP_IPC_LOCK or a memlock limit")
    return refused
