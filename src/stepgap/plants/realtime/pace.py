"""When a tick begins on the wall clock, and what a process asks of the kernel to be in time."""

import ctypes
import gc
import os
from collections.abc import Callable
from time import perf_counter, sleep

Pace = Callable[[float], float]
"""Waits until a time since the start and says when it returns; both [s]."""

SPIN = 1.5e-4
"""Time before a due time from which on the clock is watched instead of sleeping [s]."""

_PRIORITY = 80
"""Of SCHED_FIFO; the kernel's interrupt threads have 50."""

MCL_CURRENT_AND_FUTURE = 3


class WallClock:
    """A `Pace` that sleeps until shortly before a due time, then spins; it starts when it is made."""

    def __init__(self) -> None:
        self._start = perf_counter()

    def __call__(self, due: float) -> float:
        """Waits."""
        left = due - self._now() - SPIN
        if left > 0:
            sleep(left)
        while (now := self._now()) < due:
            pass
        return now

    def _now(self) -> float:
        return perf_counter() - self._start


def ask_for_realtime() -> list[str]:
    """Asks for SCHED_FIFO and locked memory, and keeps the garbage collector away; says what was refused."""
    gc.collect()
    gc.freeze()
    gc.disable()
    refused = []
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, PermissionError):
        refused.append("real-time scheduling (SCHED_FIFO) is refused: it needs root, CAP_SYS_NICE or an rtprio limit")
    try:
        locked = ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT_AND_FUTURE) == 0
    except (AttributeError, OSError):
        locked = False
    if not locked:
        refused.append("locked memory (mlockall) is refused: it needs root, CAP_IPC_LOCK or a memlock limit")
    return refused
