"""Waiting for the ticks on the wall clock, and requests to the kernel for real-time execution."""

import ctypes
import gc
import os
from collections.abc import Callable
from time import perf_counter, sleep

Pace = Callable[[float], float]
"""Waits until a time since the start and returns the time at its end; both [s]."""

SPIN = 1.5e-4
"""Time before a due time from which on the clock is polled instead of sleeping [s]."""

_PRIORITY = 80
"""Priority of SCHED_FIFO; the kernel's interrupt threads have 50."""

MCL_CURRENT_AND_FUTURE = 3


class WallClock:
    """A `Pace` that sleeps until shortly before a due time, then spins; its time starts when it is created."""

    def __init__(self) -> None:
        self._start = perf_counter()

    def __call__(self, due: float) -> float:
        """Waits until the due time [s] and returns the time [s]."""
        remaining = due - self._now() - SPIN
        if remaining > 0:
            sleep(remaining)
        while (now := self._now()) < due:
            pass
        return now

    def _now(self) -> float:
        return perf_counter() - self._start


def ask_for_realtime() -> list[str]:
    """Requests SCHED_FIFO and locked memory, and disables the garbage collector; returns the refused requests."""
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
