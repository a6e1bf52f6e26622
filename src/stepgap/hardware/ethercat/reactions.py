"""What a drive does by itself when it is stopped, or when frames end: it must give no torque (CiA 402-2, option codes).

Their factory settings are the vendor's: a drive may slow its motor down along a ramp, which is a torque that nobody
expects, or continue with the last torque if frames end.
"""

from dataclasses import dataclass
from struct import Struct

from stepgap.hardware.ethercat.startup import Objects, StartupObject, write_startup
from stepgap.rigs.rig import MissingObject

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
"""1 and 2 of 0x6007 are *fault signal* and *disable voltage*; 0 of the others is *disable drive function*."""


def secure_reactions(bus: Objects, number: int) -> list[str]:
    """Lets a drive switch torque off in each of these cases; returns remarks on the objects that it lacks.

    Raises:
        RigFault: The drive keeps another value.
    """
    remarks = []
    for reaction in REACTIONS:
        try:
            found = bus.read_object(number, reaction.index, _INT16)
        except MissingObject:
            remarks.append(
                f"{bus.label(number)} lacks object 0x{reaction.index:04X}: what it does {reaction.name} "
                "is the setting of its factory"
            )
            continue
        if found not in reaction.without_torque:
            write_startup(bus, number, StartupObject(reaction.index, 0, "INT16", reaction.without_torque[0]))
    return remarks
