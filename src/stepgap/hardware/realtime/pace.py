"""Waiting for the ticks on the wall clock, and requests to the kernel for real-time execution."""

import ctypes
import gc
import os
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, sleep

Pace = Callable[[float], float]
"""Waits until a time since the start, not at all for time 0, and returns the time at its end; both [s]."""

SPIN = 1.5e-4  # Time before a due time from which on the clock is polled instead of sleeping [s]
_PRIORITY = 80  # Priority of SCHED_FIFO; the kernel's interrupt threads have 50

MCL_CURRENT_AND_FUTURE = 3

ISOLATED = Path("/sys/devices/system/cpu/isolated")
"""Cores that the kernel leaves to programs that ask for them (`isolcpus`), such as `2-3`; empty if there are none."""

LATENCY = Path("/dev/cpu_dma_latency")
"""Device that keeps the processor from sleep states that end later than a time, as long as it is open."""

NO_PRIORITY = "real-time scheduling (SCHED_FIFO) is refused: it needs root, CAP_SYS_NICE or an rtprio limit"
NO_LOCKED_MEMORY = "locked memory (mlockall) is refused: it needs root, CAP_IPC_LOCK or a memlock limit"

NEEDED_FOR_TORQUE = (NO_PRIORITY, NO_LOCKED_MEMORY)
"""Refusals with which a real robot gets no torque; without the other requests ticks are only later."""


class WallClock:
    """A `Pace` that sleeps until shortly before a due time, then spins; its time starts when it is created.

    Python sleeps until an absolute time on the monotonic clock (`clock_nanosleep`), so an interruption before that does
    not make it late.
    """

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


def isolated_cores(text: str) -> set[int]:
    """Numbers in a list of cores as the kernel writes it, such as `2-3,6`."""
    ranges = [part.split("-") for part in text.strip().split(",") if part]
    return {core for first, *last in ranges for core in range(int(first), int(last[0] if last else first) + 1)}


def ask_for_realtime(isolated: Path = ISOLATED, latency: Path = LATENCY) -> list[str]:
    """Makes this process a real-time process as far as the kernel permits, and returns the refused requests.

    It gets SCHED_FIFO, locked memory, the last isolated core if there are any, and a processor that does not sleep
    deeply as long as the process lives; the garbage collector is disabled.
    """
    gc.collect()
    gc.freeze()
    gc.disable()
    answers = _schedule_first(), _lock_memory(), _use_isolated_core(isolated), _keep_awake(latency)
    return [refused for refused in answers if refused]


def _schedule_first() -> str:
    """Requests SCHED_FIFO; returns why it is refused, as do the next functions."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
    except (AttributeError, PermissionError):
        return NO_PRIORITY
    return ""


def _lock_memory() -> str:
    try:
        locked = ctypes.CDLL(None, use_errno=True).mlockall(MCL_CURRENT_AND_FUTURE) == 0
    except (AttributeError, OSError):
        locked = False
    return "" if locked else NO_LOCKED_MEMORY


def _use_isolated_core(isolated: Path) -> str:
    try:
        cores = isolated_cores(isolated.read_text("ascii"))
    except FileNotFoundError:  # not Linux
        return ""
    try:
        os.sched_setaffinity(0, {max(cores)} if cores else os.sched_getaffinity(0))
    except OSError as error:
        return f"the isolated core {max(cores)} is refused: {error.strerror}"
    return ""


def _keep_awake(latency: Path) -> str:
    try:
        os.write(os.open(latency, os.O_WRONLY), bytes(4))  # 0 µs as an int32; the device acts until it is closed
    except FileNotFoundError:  # neither every system nor every processor has it
        return ""
    except OSError as error:
        return f"a processor without sleep states is refused: {latency}: {error.strerror}"
    return ""


_DELAY_SHARE = 0.02
"""Weight of the last tick in the mean delay of frames; more in the first ticks, whose plain mean it is."""


class TickClock:
    """Time since the start of a deployment.

    Args:
        interval: Time between two ticks [s].

    Attributes:
        time: Time at which the present tick began [s].
        due: Time at which the next tick is due [s].
        slip: Time by which the present tick has shifted all later ones [s].
    """

    def __init__(self, interval: float):
        self.time = 0.0
        self.due = 0.0
        self.slip = 0.0
        self._interval = interval
        self._delay = 0.0
        self._share = 1.0

    def begin(self, late: float = 0.0) -> float:
        """Begins a tick that is late [s] and returns its time; a delay above an interval shifts all later ticks."""
        self.time = self.due + late
        self.slip = late if late > self._interval else 0.0
        self.due += self.slip + self._interval
        return self.time

    def shift(self, by: float) -> None:
        """Shifts the next tick and all later ones [s]."""
        self.due += by

    def frame_times(self, frames: int, worked: float) -> list[float]:
        """Times of the frames between the present tick and the next one [s]; shape (frames − 1,).

        The frame of a tick is sent when its work is done. The others have the mean of this delay, too, so that all
        frames have equal distances.

        Args:
            frames: Frames per tick, including that of the tick itself.
            worked: Time at which the work of the present tick was done [s].
        """
        begun = self.due - self._interval
        distance = self._interval / frames
        delay = min(max(worked - begun, 0.0), distance / 2)
        self._delay += self._share * (delay - self._delay)
        self._share = max(self._share / (1 + self._share), _DELAY_SHARE)
        return [begun + self._delay + number * distance for number in range(1, frames)]
