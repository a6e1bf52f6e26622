"""Distributed clocks of a slave controller (ETG.1000.4 §6.8): its clock, drift compensation, and SYNC0."""

from ctypes import c_longlong
from dataclasses import dataclass, field
from math import cos, tau
from multiprocessing import RawArray
from struct import pack_into, unpack_from
from typing import Any

from stepgap.hardware.ethercat.emulator import registers as reg

_PHASE_GAIN = 1 / 16  # Share of a difference of the times by which a compensation step shifts the clock

_RATE_GAIN = _PHASE_GAIN**2 / 4
"""Share of a difference per interval by which it changes the rate: critical damping with `_PHASE_GAIN`."""

_LARGEST_RATE = 1e-3  # Largest change of the rate by the compensation

_INTERVALS = 50_000, 10_000_000
"""Shortest and longest interval between two distributed times for which the rate is adjusted [ns]."""


@dataclass(frozen=True)
class ClockError:
    """Error of the rate of a clock, constant and slowly varying.

    Attributes:
        rate: Constant part [ppm].
        wander: Amplitude of the varying part [ppm].
        period: Period of the varying part [s].
    """

    rate: float = 0.0
    wander: float = 0.0
    period: float = 60.0

    def gained(self, time: float) -> float:
        """Time by which the clock is ahead after a true time [s]."""
        wave = self.wander * self.period / tau * (1 - cos(tau * time / self.period))
        return 1e-6 * (self.rate * time + wave)


NO_ERROR = ClockError()


@dataclass(frozen=True)
class ComputedTime:
    """A time that one process sets and the ring's process reads, in place of a clock.

    Whoever sends a frame must not change the time before the ring has read it.
    """

    memory: Any = field(default_factory=lambda: RawArray(c_longlong, 2))

    def __call__(self) -> int:
        """Returns the time [ns], and counts the call."""
        time = self.memory[0]
        self.memory[1] += 1
        return time

    @property
    def reads(self) -> int:
        """Number of frames at which the ring has read the time."""
        return self.memory[1]

    def set(self, time: int) -> None:
        """Sets the time [ns]."""
        self.memory[0] = time


class RingTime:
    """True time of a ring, which all its clocks share.

    Attributes:
        now: Time at which the present frame has reached the first slave [ns].
    """

    def __init__(self) -> None:
        self.now = 0


class SlaveClock:
    """The clock of one slave controller and its registers.

    Its local time is that of the ring with an error, as the compensation corrects it; its system time adds the offset
    that a master has written. Times that a master distributes (writes to the register of the system time) are those of
    the reference clock when the frame passed it; the compensation adds the written propagation delay.

    Args:
        memory: Memory of the slave controller.
        delay: Time of a frame from the first slave to this one [ns].
    """

    def __init__(self, memory: bytearray, time: RingTime, error: ClockError = NO_ERROR, delay: int = 0):
        self._memory = memory
        self._time = time
        self._error = error
        self._delay = delay
        self._read_at = self._own_time()
        self._local = 0.0
        self._rate = 0.0
        self._mean_difference = 0.0
        self._distributed_at: float | None = None

    def local_time(self) -> int:
        """Local time when the present frame passes [ns]."""
        own = self._own_time()
        self._local += (own - self._read_at) * (1 + self._rate)
        self._read_at = own
        return int(self._local)

    def system_time(self) -> int:
        """Local time plus offset [ns]."""
        return self.local_time() + unpack_from("<q", self._memory, reg.DC_OFFSET)[0]

    def latch(self, travel_behind: int) -> None:
        """Latches the times at which the present frame passes the ports 0 and 1.

        Args:
            travel_behind: Time until it comes back from the slaves behind this one [ns].
        """
        local = self.local_time()
        pack_into("<II", self._memory, reg.DC_RECEIVE_TIME, local % 2**32, (local + travel_behind) % 2**32)
        pack_into("<Q", self._memory, reg.DC_RECEIVE_TIME_UNIT, local % 2**64)

    def refresh(self) -> None:
        """Writes system time and mean difference into their registers, before they are read."""
        pack_into("<Q", self._memory, reg.DC_SYSTEM_TIME, self.system_time() % 2**64)
        difference = round(self._mean_difference)
        sign = 0x80000000 if difference < 0 else 0  # ahead of the reference clock is positive here
        pack_into("<I", self._memory, reg.DC_DIFFERENCE, sign | min(abs(difference), 0x7FFFFFFF))

    def compensate(self, distributed: int) -> None:
        """Adjusts phase and rate to a distributed time, of which the lowest 32 bits count [ns]."""
        before = self._distributed_at
        delay = unpack_from("<I", self._memory, reg.DC_DELAY)[0]
        ahead = (self.system_time() - distributed - delay + 2**31) % 2**32 - 2**31
        now = self._distributed_at = self._read_at
        self._mean_difference += _PHASE_GAIN * (ahead - self._mean_difference)
        self._local -= _PHASE_GAIN * ahead
        if before is not None and now > before:
            shortest, longest = _INTERVALS
            rate = self._rate - _RATE_GAIN * ahead / min(max(now - before, shortest), longest)
            self._rate = min(max(rate, -_LARGEST_RATE), _LARGEST_RATE)

    def reset_compensation(self) -> None:
        """Restarts the compensation, as a write to the speed counter does."""
        self._rate = 0.0
        self._mean_difference = 0.0
        self._distributed_at = None

    def _own_time(self) -> float:
        """Time of the clock without compensation [ns]."""
        now = self._time.now + self._delay
        return now + 1e9 * self._error.gained(1e-9 * now)


@dataclass(frozen=True)
class Sync0:
    """The SYNC0 signal as a master has configured it.

    Attributes:
        active: Cyclic operation and SYNC0 are activated.
        start: System time of the first event [ns].
        cycle: Time between two events [ns].
    """

    active: bool
    start: int
    cycle: int

    @classmethod
    def of(cls, memory: bytearray) -> "Sync0":
        """Reads the registers of a slave controller."""
        (start,) = unpack_from("<Q", memory, reg.DC_START)
        (cycle,) = unpack_from("<I", memory, reg.DC_CYCLE_0)
        return cls(memory[reg.DC_ACTIVATION] & reg.DC_SYNC0_ACTIVE == reg.DC_SYNC0_ACTIVE, start, cycle)

    def events(self, time: int) -> int:
        """Number of events up to a system time [ns]."""
        if not (self.active and self.cycle) or time < self.start:
            return 0
        return (time - self.start) // self.cycle + 1

    def since_event(self, time: int) -> int:
        """Time since the last event [ns]; only if there was one."""
        return (time - self.start) % self.cycle


class SyncWatch:
    """A drive's supervision of its outputs: exactly one frame is expected between two SYNC0 events.

    The counter of errors is that of ETG.1020 (object 0x10F1): it rises by 3 for an interval without a frame in its
    window, and falls by 1 for a good one.

    Args:
        limit: Largest count of errors.
        guard: Share of the cycle before and after an event in which no frame may pass: the drive copies its outputs.
    """

    def __init__(self, limit: int, guard: float):
        self._limit = limit
        self._guard = guard
        self._last = 0
        self.errors = 0

    def start(self, sync: Sync0, time: int) -> None:
        """Begins with the interval that contains a system time [ns]."""
        self._last = sync.events(time)
        self.errors = 0

    def passed(self, sync: Sync0, time: int) -> bool:
        """Counts a frame with outputs at a system time [ns]; returns False if there were too many errors."""
        number = sync.events(time)
        guard = self._guard * sync.cycle
        if number == self._last:
            return self.errors <= self._limit
        missed = max(0, number - self._last - 1)
        self._last = number
        if guard <= sync.since_event(time) <= sync.cycle - guard:
            self.errors = max(0, self.errors + 3 * missed - 1)
        else:
            self.errors += 3 * (missed + 1)
        return self.errors <= self._limit
