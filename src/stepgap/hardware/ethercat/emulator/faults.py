"""Scripted faults of a ring; cycles are frames with outputs (LRW, LWR), counted from 0 since the ring started."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Self

_REQUIRED = object()  # In the tables below: a number that has no default

FRAME_FAULTS: Mapping[str, Mapping[str, Any]] = {
    # Frames never reach the slaves, so many in a row.
    "lost frames": {"cycles": 1},
    # A frame reaches the slaves in time but comes back only immediately before the next one.
    "late frame": {},
    # A frame comes back twice.
    "duplicated frame": {},
    # A pause before a frame, as if the master stopped, in ticks of the machine.
    "silence": {"ticks": _REQUIRED},
}
"""Kinds of faults of frames, with the defaults of their numbers."""

_SLAVE_FAULTS: Mapping[str, Mapping[str, Any]] = {
    # A slave and all behind it are disconnected, with power on; a ring without slaves does not answer.
    "unplugged": {"cycles": _REQUIRED},
    # A slave loses power and comes back in INIT; those behind it are disconnected meanwhile.
    "power lost": {"cycles": _REQUIRED},
    # Its application hangs: inputs and torque do not change; its slave controller still processes frames.
    "stalled": {"cycles": _REQUIRED},
    # It sends an emergency with an error code, and continues.
    "emergency": {"code": 0x4210},
    # It expects one byte of inputs more than its PDOs have: SAFEOP is refused, or lost, with code 0x1E.
    "wrong mapping": {},
}

SENSOR_FAULTS: Mapping[str, Mapping[str, Any]] = {
    # The value does not change any more. The velocity of a drive follows, as if its encoder had failed, or remains
    # true, as if only the position were not updated.
    "frozen": {"with_velocity": True},
    # It jumps by some counts and stays shifted, as after lost counts.
    "shifted": {"counts": _REQUIRED},
    # It has normal noise, always the same sequence, with a standard deviation [counts].
    "noisy": {"deviation": _REQUIRED},
    # A terminal sets bits of its status word, by default *TxPDO State*: its data are not valid. Its value is right.
    "reported error": {"bits": 0x4000},
}
"""Kinds of faults of the sensor of a drive or terminal, with the defaults of their numbers."""

DRIVE_FAULTS: Mapping[str, Mapping[str, Any]] = {
    # The drive trips with an error code (object 0x603F).
    "trip": {"code": 0x2310},
    # Digital inputs (bits of 0x60FD) open, and it gives no torque: by default both channels of its STO input. With a
    # code it goes to fault; with 0 it only disables its power stage.
    "opened input": {"bits": 0x3_0000, "code": 0},
    # Its temperature rises at a rate [K/s], in addition to that by losses.
    "heated": {"rate": _REQUIRED},
    # Its bus is fed with a power [W], as by another drive that brakes; negative if it is drawn.
    "fed bus": {"power": _REQUIRED},
    # An object has a fixed number, by default its present one, as after a failure of its measurement.
    "stuck object": {"index": _REQUIRED, "value": None},
    # An enabled drive, whose statusword remains right, gives `factor` times the commanded torque (0: it is dead or runs
    # away, −1: wrong sign) plus an offset in 1/1000 of the rated torque, or keeps the torque that it had in that cycle.
    # Its actual torque (0x6077) shows this if it is reported, otherwise the command.
    "wrong torque": {"factor": 0.0, "offset": 0, "is_kept": False, "is_reported": True},
    # Bits of the status word are 1 (raised) or 0 (cleared) from now on, while the drive works as before.
    "status bits": {"raised": 0, "cleared": 0},
    # Its torque, also the reported one, follows the commands so many ticks later, or its position is older.
    "delayed": {"torque": 0, "counts": 0},
}
"""Kinds of faults of a drive, with the defaults of their numbers."""

FAULT_KINDS: Mapping[str, Mapping[str, Any]] = {**FRAME_FAULTS, **_SLAVE_FAULTS, **SENSOR_FAULTS, **DRIVE_FAULTS}
"""Kinds of faults, with the defaults of their numbers."""


@dataclass(frozen=True, init=False)
class Fault:
    """A fault that begins in a cycle; those of sensors and drives last until the end.

    Args:
        kind: One of `FAULT_KINDS`.
        cycle: First cycle; a wrong mapping in cycle 0 is there from the start.
        slave: Name of the slave; empty for a fault of frames.
        numbers: Numbers of this kind; those that are left out have their defaults.

    Raises:
        ValueError: There is no such kind, it has other numbers, or it lacks the name of a slave.
    """

    kind: str
    cycle: int
    slave: str
    numbers: Mapping[str, Any] = field(hash=False)

    def __init__(self, kind: str, cycle: int, slave: str = "", **numbers: Any):
        if kind not in FAULT_KINDS:
            raise ValueError(f"there is no fault '{kind}'; the faults are {', '.join(FAULT_KINDS)}")
        given = {**FAULT_KINDS[kind], **numbers}
        if given.keys() != FAULT_KINDS[kind].keys() or _REQUIRED in given.values():
            raise ValueError(
                f"a fault '{kind}' has the numbers {', '.join(FAULT_KINDS[kind]) or 'none'}, not {numbers}"
            )
        if bool(slave) == (kind in FRAME_FAULTS):
            raise ValueError(f"a fault '{kind}' is one of {'frames' if slave else 'a slave, so name it'}")
        for name, value in {"kind": kind, "cycle": cycle, "slave": slave, "numbers": given}.items():
            object.__setattr__(self, name, value)

    def __getitem__(self, name: str) -> Any:
        """A number of this kind."""
        return self.numbers[name]

    def at(self, cycle: int) -> Self:
        """The same fault from another cycle on."""
        return type(self)(self.kind, cycle, self.slave, **self.numbers)

    def lasts(self, cycle: int) -> bool:
        """Whether a fault that ends after some cycles acts in this one."""
        return self.cycle <= cycle < self.cycle + self.numbers["cycles"]
