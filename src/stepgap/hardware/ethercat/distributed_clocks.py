"""Frames steered to the reference clock of a bus with distributed clocks.

The reference clock is that of the first slave that has one. Every frame with outputs distributes its system time to the
others, which SOEM arranges with a second datagram (FRMW), and brings it to the master. The frames shall pass it at
whole multiples of the cycle of its system time; SYNC0 of a slave follows later by its shift.
"""

from dataclasses import dataclass
from math import isfinite, nan

from stepgap.base.ranges import require
from stepgap.hardware.bus_rig import COMPUTER, HostTime
from stepgap.rigs.rig import ClockLimits

SYNC0_ONLY = 0x0300  # *AssignActivate* of an ESI file for a slave that needs this signal
SYNC0_AND_SYNC1 = 0x0700  # The same for both signals
LOCKED_FRAMES = 50  # Number of consecutive frames within the window until the frames count as synchronised
_PHASE_GAIN = 0.05  # Share of an offset by which the next frame is shifted
_RATE_GAIN = _PHASE_GAIN**2 / 4  # Share of an offset by which the interval changes: critical damping with `_PHASE_GAIN`
_LARGEST_OFFSET = 0.01  # Offset that counts at most [cycles], so that a late tick hardly shifts the ticks after it

_SETTLING = 100  # Number of corrections after the first one in which more counts:
_LARGEST_FIRST_OFFSET = 0.1  # by the work of a tick, frames are later than in the first one [cycles]

_LARGEST_RATE = 1e-3  # Largest change of the interval between two frames [cycles]; clocks differ by less than 1e-4


@dataclass(frozen=True, kw_only=True)
class DcSettings:
    """Limits of the frames on the reference clock.

    Attributes:
        window: Largest distance of a frame from its time [cycles]; it must be less than the shifts of SYNC0.
        outside: Largest number of consecutive frames outside of it.
        usual: Largest distance of 99.9 % of the frames in a check [windows].
        difference: Largest difference of a slave's clock from the reference clock in a check [s].
    """

    window: float = 0.25
    outside: int = 20
    usual: float = 0.5
    difference: float = 1e-6

    def __post_init__(self) -> None:
        require(0.01 <= self.window < 0.5, "window", self.window, "lie between 0.01 and 0.5")
        require(1 <= self.outside <= 1000, "outside", self.outside, "lie between 1 and 1000")
        require(0 < self.usual <= 1, "usual", self.usual, "be positive and at most 1")
        require(1e-8 <= self.difference <= 1e-4, "difference", self.difference, "lie between 1e-8 and 1e-4")

    def limits(self, cycle: float) -> ClockLimits:
        """Limits for a time between two frames [s]."""
        window = self.window * cycle
        return ClockLimits(self.usual * window, window, self.outside, self.difference)


def offset_from_grid(time: int, cycle: int) -> int:
    """Distance of a time from the nearest multiple of a cycle, positive if later; all [ns]."""
    return (time + cycle // 2) % cycle - cycle // 2


class Steering:
    """Steers the transmission of frames to the reference clock with a PI law.

    Args:
        cycle: Time between two frames [s].
        settings: Limits of the frames.
    """

    def __init__(self, cycle: float, settings: DcSettings, host: HostTime = COMPUTER):
        self._cycle = cycle
        self._settings = settings
        self.host = host
        self._sent_at = host.now()
        self._due = host.now()
        self._rate = 0.0
        self._aligned = False
        self._settling = _SETTLING
        self._fresh = False
        self._outside = 0
        self._inside = 0
        self._tick_ends = False
        self._tick_begins = True
        self.offset = nan
        """Time by which the last good frame passed the reference clock too late [s]."""
        self.farthest = nan
        """The offset that is farthest from zero, of the good frames since those of the last tick [s]."""
        self.outside = 0
        """Largest number of frames in a row outside of the window that these frames have reached."""
        self.shift = 0.0
        """Last correction of the interval between frames [s]."""

    @property
    def is_locked(self) -> bool:
        """Whether enough frames in a row were within the window."""
        return self._inside >= LOCKED_FRAMES

    @property
    def fault(self) -> str:
        """Why the frames are not synchronised any more; empty if they are."""
        if self._outside <= self._settings.outside:
            return ""
        return (
            f"{self._outside} frames in a row were more than {1e6 * self._settings.window * self._cycle:.0f} µs away "
            f"from their time on the reference clock, the last one {1e6 * self.offset:+.0f} µs"
        )

    def sent(self) -> None:
        """Notes that a frame is being sent now."""
        self._sent_at = self.host.now()

    def returned(self, time: int) -> None:
        """Notes the system time of the reference clock when the last frame passed it [ns]."""
        self.offset = 1e-9 * offset_from_grid(time, round(1e9 * self._cycle))
        self._fresh = True
        outside = abs(self.offset) > self._settings.window * self._cycle
        self._outside = self._outside + 1 if outside else 0
        self._inside = 0 if outside else self._inside + 1
        self.farthest = self.offset if self._tick_begins else max(self.farthest, self.offset, key=abs)
        self.outside = self._outside if self._tick_begins else max(self.outside, self._outside)
        self._tick_begins = self._tick_ends
        self._tick_ends = False

    def correction(self, slip: float = 0.0, frames: int = 1) -> float:
        """Time by which the next frame and all later ones shall be sent later [s], given the last offset.

        The first time, or after `restart`, it is the time from now until a frame would pass in phase.

        Args:
            slip: Time by which a late frame has shifted all later ones, which is completed to whole cycles [s].
            frames: Number of frames between two corrections, in which the clocks drift.
        """
        self._tick_ends = True  # with the next frame that returns
        if not self._aligned:
            self._aligned = isfinite(self.offset)
            to_grid = -(self.offset + self.host.now() - self._sent_at) % self._cycle if self._aligned else 0.0
            self.shift = to_grid
            return self.shift
        # A PI law: `_rate` is the drift of the clocks, and an offset counts once, so that after a lost frame only the
        # drift is followed. Both are bounded, because a late frame says nothing of the clocks. A slip is completed to
        # whole cycles, which keeps all later frames in phase.
        if self._fresh:
            self._settling -= self._settling > 0
            most = (_LARGEST_FIRST_OFFSET if self._settling else _LARGEST_OFFSET) * self._cycle
            counted = min(max(self.offset, -most), most)
            limit = _LARGEST_RATE * self._cycle
            self._rate = min(max(self._rate - _RATE_GAIN * counted / frames, -limit), limit)
            self.shift = frames * self._rate - _PHASE_GAIN * counted
        else:
            self.shift = frames * self._rate
        self._fresh = False
        self.shift += -slip % self._cycle
        return self.shift

    def restart(self) -> None:
        """Begins a new sequence of frames, whose first one is not yet in phase; the rate remains."""
        self._aligned = self._fresh = False
        self._due = self.host.now()
        self._settling = _SETTLING

    def wait(self) -> None:
        """Waits until the next frame is due, outside of a control loop."""
        now = self.host.now()
        if self._due < now - self._cycle:
            self.restart()  # this thread was interrupted: the frames before are lost
        aligned = self._aligned
        correction = self.correction()
        self._due = self._due + self._cycle + correction if aligned else now + correction
        self.host.pause(max(0.0, self._due - now))
