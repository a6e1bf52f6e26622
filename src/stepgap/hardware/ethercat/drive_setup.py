"""What a bus writes to its slaves and drives by SDO before they get torque, and checks of what they answer."""

from dataclasses import dataclass
from struct import Struct

from stepgap.hardware.ethercat.cia402 import CYCLIC_TORQUE
from stepgap.hardware.ethercat.pdo import Packing
from stepgap.hardware.ethercat.rig_settings import BusSettings, Motor
from stepgap.hardware.ethercat.startup import Objects, StartupObject, write_startup
from stepgap.rigs.rig import MissingObject, RigFault

_INT16 = Struct("<h")


@dataclass(frozen=True)
class Reaction:
    """An option code.

    Attributes:
        index: Index of the object.
        name: What it determines.
        without_torque: Values after which the motor gets no torque; the first one is written.
    """

    index: int
    name: str
    without_torque: tuple[int, ...]


REACTIONS = (
    Reaction(0x6007, "when frames end", (1, 2)),
    Reaction(0x605A, "after a quick stop", (0,)),
    Reaction(0x605B, "after a shutdown", (0,)),
    Reaction(0x605C, "when it is disabled", (0,)),
    Reaction(0x605E, "after a fault", (0,)),
)
"""What a drive does by itself when it is stopped, or when frames end: it must give no torque (CiA 402-2, option codes).

Their factory settings are the vendor's: a drive may slow its motor down along a ramp, which is a torque that nobody
expects, or continue with the last torque if frames end. 1 and 2 of 0x6007 are *fault signal* and
*disable voltage*; 0 of the others is *disable drive function*.
"""


def secure_reactions(bus: Objects, number: int) -> list[str]:
    """Lets a drive switch torque off in each of these cases; returns remarks on the objects that it lacks.

    Raises:
        RigFault: The drive keeps another value.
    """
    remarks = []
    for reaction in REACTIONS:
        try:
            code = bus.read_object(number, reaction.index, _INT16)
        except MissingObject:
            remarks.append(
                f"{bus.label(number)} lacks object 0x{reaction.index:04X}: what it does {reaction.name} "
                "is the setting of its factory"
            )
            continue
        if code not in reaction.without_torque:
            write_startup(bus, number, StartupObject(reaction.index, 0, "INT16", reaction.without_torque[0]))
    return remarks


_MODE = 0x6060
_MODE_DISPLAY = 0x6061
_LARGEST_TORQUE = 0x6072
_RATED_TORQUE = 0x6076
_U16 = Struct("<H")
_U32 = Struct("<I")
_I8 = Struct("<b")


def prepare_slaves(bus: Objects, settings: BusSettings) -> list[str]:
    """Writes the objects that the settings demand, and prepares the drives, in PREOP.

    Returns:
        Remarks on objects that a drive lacks.

    Raises:
        RigFault: A slave refuses an object, or the rated torque of a drive differs from the settings.
    """
    for number, slave in enumerate(settings.slaves):
        for wanted in slave.startup_objects:
            write_startup(bus, number, wanted)
    remarks = []
    for motor in settings.motors:
        drive = settings.position(motor.slave)
        if not motor.keep_reactions:
            remarks += secure_reactions(bus, drive)
        if "mode" not in _process_data(settings, drive):
            write_startup(bus, drive, StartupObject(_MODE, 0, "INT8", CYCLIC_TORQUE))
    for motor in settings.motors:
        _limit_torque(bus, settings.position(motor.slave), motor)
    return remarks


def check_modes(bus: Objects, settings: BusSettings) -> None:
    """Ensures that enabled drives which do not report their mode in each frame are in that of torque.

    Raises:
        RigFault: A drive is in another mode.
    """
    for drive in (settings.position(motor.slave) for motor in settings.motors):
        if "mode_display" not in _process_data(settings, drive):
            mode = bus.read_object(drive, _MODE_DISPLAY, _I8)
            if mode != CYCLIC_TORQUE:
                raise RigFault(f"{bus.label(drive)} is in mode {mode} (0x6061), not in {CYCLIC_TORQUE}")


def _limit_torque(bus: Objects, drive: int, motor: Motor) -> None:
    rated = bus.read_object(drive, _RATED_TORQUE, _U32)
    if rated != motor.rated_units:
        raise RigFault(
            f"{bus.label(drive)} has a rated torque of {rated * motor.rated_torque_unit:g} N·m (0x6076), "
            f"but the settings have {motor.rated_torque:g}"
        )
    bus.write_object(drive, _LARGEST_TORQUE, _U16, motor.most_units)


def _process_data(settings: BusSettings, drive: int) -> set[str]:
    """Names of the values that a drive exchanges in each frame."""
    pdos = settings.pdo_set(settings.slaves[drive])
    return {*Packing(pdos.outputs).names, *Packing(pdos.inputs).names}
