"""Scripted disturbances of a ring. Cycles are frames with outputs (LRW, LWR), counted from 0 since the ring began."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LostFrames:
    """Frames that never reach the slaves.

    Attributes:
        cycle: The first one.
        cycles: How many in a row.
    """

    cycle: int
    cycles: int = 1


@dataclass(frozen=True)
class LateFrame:
    """A frame that reaches the slaves in time and comes back only with the next one, before it."""

    cycle: int


@dataclass(frozen=True)
class DuplicatedFrame:
    """A frame that comes back twice."""

    cycle: int


@dataclass(frozen=True)
class Silence:
    """Time in which no frame comes, as if the master stood still before it sent this one.

    Attributes:
        cycle: The frame before which it is silent.
        ticks: How long, in ticks of the machine.
    """

    cycle: int
    ticks: int


@dataclass(frozen=True)
class Unplugged:
    """A slave and all behind it are out of reach for a while, with power on; a ring without slaves answers nothing.

    Attributes:
        cycle: The first one without it.
        slave: Its name.
        cycles: How many.
    """

    cycle: int
    slave: str
    cycles: int


@dataclass(frozen=True)
class PowerLost(Unplugged):
    """A slave loses power and comes back in INIT; those behind it are out of reach meanwhile."""


@dataclass(frozen=True)
class Stalled(Unplugged):
    """A slave's application hangs: inputs freeze, torque stays; its slave controller goes on and counts."""


@dataclass(frozen=True)
class DriveFault:
    """A drive trips.

    Attributes:
        cycle: When.
        slave: The drive's name.
        code: Error code (object 0x603F).
    """

    cycle: int
    slave: str
    code: int = 0x2310


@dataclass(frozen=True)
class SentEmergency:
    """A slave sends an emergency and goes on.

    Attributes:
        cycle: When.
        slave: Its name.
        code: Error code in the message.
    """

    cycle: int
    slave: str
    code: int = 0x4210


@dataclass(frozen=True)
class WrongMapping:
    """A slave wants one byte of inputs more than its PDOs have: SAFEOP is refused, or lost, with code 0x1E.

    Attributes:
        cycle: From when on; 0 is from the beginning.
        slave: Its name.
    """

    cycle: int
    slave: str


Fault = (
    LostFrames
    | LateFrame
    | DuplicatedFrame
    | Silence
    | Unplugged
    | PowerLost
    | Stalled
    | DriveFault
    | SentEmergency
    | WrongMapping
)
