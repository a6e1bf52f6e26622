"""Settings of an emulated ring."""

from dataclasses import dataclass

from stepgap.hardware.ethercat.emulator.clock import NO_ERROR, ClockError
from stepgap.hardware.ethercat.emulator.faults import Fault


@dataclass(frozen=True)
class RingClocks:
    """Distributed clocks of a ring.

    Attributes:
        errors: Errors of the slaves' clocks, in the order of the ring; missing ones are zero.
        hop_delay: Time of a frame from one slave to the next [ns].
        need_sync0: Names of the slaves that refuse OP without SYNC0 and leave it if frames miss their windows.
        error_limit: Largest count of errors of such a slave: 3 for a missed window, less 1 for a good one.
        guard: Share of a cycle before and after SYNC0 in which no frame may pass such a slave.
    """

    errors: tuple[ClockError, ...] = ()
    hop_delay: int = 500
    need_sync0: tuple[str, ...] = ()
    error_limit: int = 9
    guard: float = 0.1

    def error(self, number: int) -> ClockError:
        """Error of the clock of a slave, counted from 0."""
        return self.errors[number] if number < len(self.errors) else NO_ERROR


@dataclass(frozen=True)
class RingSettings:
    """Settings of the ring's devices and of its timing.

    Attributes:
        rated_torque: Torque of the value 1000 of a drive's torque object [mN·m].
        largest_torque: The drives' limit in 1/1000 of `rated_torque`.
        force_resolution: Contact force of one count of the analog input [N].
        lock_step: Whether a frame with outputs is one tick of the machine; otherwise `Ring.advance` makes ticks.
        inputs_after_tick: In lock-step, whether such a frame returns the inputs after its tick, as if sensors were
            faster than the frame; otherwise those before it, as on a real ring, where effects appear a cycle later.
        clocks: Distributed clocks.
        faults: Scripted faults.
    """

    rated_torque: int = 16_000
    largest_torque: int = 2500
    force_resolution: float = 0.1
    lock_step: bool = True
    inputs_after_tick: bool = False
    clocks: RingClocks = RingClocks()
    faults: tuple[Fault, ...] = ()


DRIFTING_CLOCKS = RingClocks(
    errors=tuple(ClockError(rate, 15.0, 90.0 + 10 * number) for number, rate in enumerate((80, -80, 30, -50, 60, 0))),
    need_sync0=("drive_1", "drive_2"),
)
"""Clocks of the hopper's ring that differ by up to ±95 ppm, with drives that need SYNC0."""
