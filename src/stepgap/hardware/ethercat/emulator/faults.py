"""Scripted faults of a ring; cycles are frames with outputs (LRW, LWR), counted from 0 since the ring started."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LostFrames:
    """Frames that never reach the slaves.

    Attributes:
        cycle: First lost frame.
        cycles: Number of consecutive lost frames.
    """

    cycle: int
    cycles: int = 1


@dataclass(frozen=True)
class LateFrame:
    """A frame that reaches the slaves in time but comes back only immediately before the next one."""

    cycle: int


@dataclass(frozen=True)
class DuplicatedFrame:
    """A frame that comes back twice."""

    cycle: int


@dataclass(frozen=True)
class Silence:
    """A pause without frames, as if the master stopped before it sent this one.

    Attributes:
        cycle: Frame before which the pause is.
        ticks: Duration in ticks of the machine.
    """

    cycle: int
    ticks: int


@dataclass(frozen=True)
class Unplugged:
    """A slave and all behind it are disconnected for a while, with power on; a ring without slaves does not answer.

    Attributes:
        cycle: First cycle without the slave.
        slave: Its name.
        cycles: Number of cycles.
    """

    cycle: int
    slave: str
    cycles: int


@dataclass(frozen=True)
class PowerLost(Unplugged):
    """A slave loses power and comes back in INIT; those behind it are disconnected meanwhile."""


@dataclass(frozen=True)
class Stalled(Unplugged):
    """A slave's application hangs: inputs and torque do not change; its slave controller still processes frames."""


@dataclass(frozen=True)
class DriveFault:
    """A drive trips.

    Attributes:
        cycle: Cycle in which it trips.
        slave: Name of the drive.
        code: Error code (object 0x603F).
    """

    cycle: int
    slave: str
    code: int = 0x2310


@dataclass(frozen=True)
class SentEmergency:
    """A slave sends an emergency and continues.

    Attributes:
        cycle: Cycle in which it is sent.
        slave: Name of the slave.
        code: Error code in the message.
    """

    cycle: int
    slave: str
    code: int = 0x4210


@dataclass(frozen=True)
class WrongMapping:
    """A slave expects one byte of inputs more than its PDOs have: SAFEOP is refused, or lost, with code 0x1E.

    Attributes:
        cycle: First cycle; 0 is from the start.
        slave: Name of the slave.
    """

    cycle: int
    slave: str


@dataclass(frozen=True)
class FrozenSensor:
    """A sensor value that does not change any more.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive or terminal.
        with_velocity: Whether a drive's velocity follows its frozen position, as if its encoder had failed; otherwise
            it remains true, as if only the position were not updated.
    """

    cycle: int
    slave: str
    with_velocity: bool = True


@dataclass(frozen=True)
class ShiftedSensor:
    """A sensor value that jumps and stays shifted, as after lost counts.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive or terminal.
        counts: The shift.
    """

    cycle: int
    slave: str
    counts: int


@dataclass(frozen=True)
class NoisySensor:
    """A sensor value with normal noise, always the same sequence.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive or terminal.
        deviation: Standard deviation of the noise [counts].
    """

    cycle: int
    slave: str
    deviation: float


@dataclass(frozen=True)
class ReportedError:
    """A terminal that sets bits of its status word, while its value remains right.

    Attributes:
        cycle: First cycle.
        slave: Name of the terminal.
        bits: The bits; by default *TxPDO State*, its data are not valid.
    """

    cycle: int
    slave: str
    bits: int = 0x4000


@dataclass(frozen=True)
class OpenedInput:
    """Digital inputs of a drive open, and it gives no torque: by default both channels of its STO input.

    Attributes:
        cycle: Cycle in which they open.
        slave: Name of the drive.
        bits: Their bits in 0x60FD.
        code: Error code (object 0x603F) with which the drive goes to fault; 0 if it only disables its power stage.
    """

    cycle: int
    slave: str
    bits: int = 0x3_0000
    code: int = 0


@dataclass(frozen=True)
class Heated:
    """A drive that becomes hot from outside.

    Attributes:
        cycle: Cycle in which it begins.
        slave: Name of the drive.
        rate: Rate at which the temperature rises, in addition to that by losses [K/s].
    """

    cycle: int
    slave: str
    rate: float


@dataclass(frozen=True)
class FedBus:
    """The bus of a drive is fed with power from outside, as by another drive that brakes.

    Attributes:
        cycle: Cycle in which it begins.
        slave: Name of the drive.
        power: The power, negative if it is drawn [W].
    """

    cycle: int
    slave: str
    power: float


@dataclass(frozen=True)
class StuckObject:
    """An object of a drive that has a fixed number from now on, as after a failure of its measurement.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive.
        index: Index of the object.
        value: The number; None for the present one.
    """

    cycle: int
    slave: str
    index: int
    value: int | None = None


@dataclass(frozen=True)
class WrongTorque:
    """A drive that gives another torque than commanded while it is enabled; its statusword remains right.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive.
        factor: Torque given per torque commanded: 0 of a dead drive or one that runs away, −1 with a wrong sign.
        offset: Torque given in addition, in 1/1000 of the rated torque.
        is_kept: The drive keeps the torque that it had in that cycle.
        is_reported: Whether its actual torque (0x6077) shows it; otherwise it shows the command.
    """

    cycle: int
    slave: str
    factor: float = 0.0
    offset: int = 0
    is_kept: bool = False
    is_reported: bool = True


@dataclass(frozen=True)
class StatusBits:
    """A drive that sets or clears bits of its status word, while it works as before.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive.
        raised: Bits that are 1 from now on.
        cleared: Bits that are 0 from now on.
    """

    cycle: int
    slave: str
    raised: int = 0
    cleared: int = 0


@dataclass(frozen=True)
class Delayed:
    """A drive whose torque follows its commands later, or whose encoder values are older.

    Attributes:
        cycle: First cycle.
        slave: Name of the drive.
        torque: Number of ticks by which its torque, also the reported one, is later.
        counts: Number of ticks by which its position is older.
    """

    cycle: int
    slave: str
    torque: int = 0
    counts: int = 0


DriveCondition = OpenedInput | Heated | FedBus | StuckObject | WrongTorque | StatusBits | Delayed

SensorFault = FrozenSensor | ShiftedSensor | NoisySensor | ReportedError

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
    | DriveCondition
    | SensorFault
)
