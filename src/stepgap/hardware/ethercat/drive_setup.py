"""What a bus writes to its slaves and drives by SDO before they get torque, and checks of what they answer."""

from struct import Struct

from stepgap.hardware.ethercat.cia402 import CYCLIC_TORQUE
from stepgap.hardware.ethercat.pdo import Packing
from stepgap.hardware.ethercat.reactions import secure_reactions
from stepgap.hardware.ethercat.rig_settings import BusSettings, Motor
from stepgap.hardware.ethercat.startup import Objects, StartupObject, write_startup
from stepgap.rigs.rig import RigFault

_MODE, _MODE_DISPLAY, _LARGEST_TORQUE, _RATED_TORQUE = 0x6060, 0x6061, 0x6072, 0x6076
_U16, _U32, _I8 = Struct("<H"), Struct("<I"), Struct("<b")


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
    """Compares a drive's rated torque with the settings and sets its torque limit."""
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
