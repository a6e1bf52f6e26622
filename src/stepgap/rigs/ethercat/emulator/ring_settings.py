"""Settings of an emulated ring."""

from dataclasses import dataclass

from stepgap.rigs.ethercat.emulator.faults import Fault


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
        faults: Scripted faults.
    """

    rated_torque: int = 16_000
    largest_torque: int = 2500
    force_resolution: float = 0.1
    lock_step: bool = True
    inputs_after_tick: bool = False
    faults: tuple[Fault, ...] = ()
