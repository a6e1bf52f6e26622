"""How an emulated ring is made up and how it passes frames."""

from dataclasses import dataclass

from stepgap.rigs.ethercat.emulator.faults import Fault


@dataclass(frozen=True)
class RingSettings:
    """How the ring is made up and how it passes frames.

    Attributes:
        rated_torque: What 1000 of a drive's torque means [mN·m].
        largest_torque: The drives' limit in 1/1000 of `rated_torque`.
        force_resolution: Contact force of one count of the analog input [N].
        lock_step: A frame with outputs is one tick of the machine; otherwise `Ring.advance` makes ticks.
        inputs_after_tick: In lock-step, such a frame brings back the inputs after its tick, as if sensors were faster
            than the frame; otherwise those before it, as on a real ring, where a cycle passes before an effect is seen.
        faults: Scripted disturbances.
    """

    rated_torque: int = 16_000
    largest_torque: int = 2500
    force_resolution: float = 0.1
    lock_step: bool = True
    inputs_after_tick: bool = False
    faults: tuple[Fault, ...] = ()
