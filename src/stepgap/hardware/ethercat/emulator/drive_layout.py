"""Which objects an emulated drive exchanges."""

from collections.abc import Mapping
from dataclasses import dataclass

from stepgap.hardware.ethercat.emulator.dictionary import Mapped, ObjectEntry, Pdos


@dataclass(frozen=True)
class DriveLayout:
    """PDOs of a drive after power-up.

    Attributes:
        outputs: PDOs from the master.
        inputs: PDOs to the master.
        assigned_outputs: Those of the outputs that are exchanged.
        assigned_inputs: Those of the inputs that are exchanged.
        mappable: Whether a master may write the contents of PDOs.
    """

    outputs: Pdos
    inputs: Pdos
    assigned_outputs: tuple[int, ...]
    assigned_inputs: tuple[int, ...]
    mappable: bool = True

    def idle_objects(self, known: Mapping[tuple[int, int], ObjectEntry]) -> dict[tuple[int, int], ObjectEntry]:
        """Objects in these PDOs that the drive does not implement: they remain 0, or as the master sets them."""
        parts = {part for pdos in (self.outputs, self.inputs) for entries in pdos.values() for part in entries}
        return {
            (part.index, part.subindex): ObjectEntry(0, part.bits)
            for part in parts
            if part.index and (part.index, part.subindex) not in known
        }


ELMO_LAYOUT = DriveLayout(
    outputs={
        0x1602: (Mapped(0x6071, 0, 16), Mapped(0x6040, 0, 16)),
        0x160B: (Mapped(0x6060, 0, 8), Mapped(0, 0, 8)),
    },
    inputs={
        0x1A02: (
            Mapped(0x6064, 0, 32),
            Mapped(0x6077, 0, 16),
            Mapped(0x6041, 0, 16),
            Mapped(0x6061, 0, 8),
            Mapped(0, 0, 8),
        ),
        0x1A11: (Mapped(0x606C, 0, 32),),
    },
    assigned_outputs=(0x1602,),
    assigned_inputs=(0x1A02,),
)
"""PDOs for torque control with the mapping of Elmo's drives; only 0x1602 and 0x1A02 are assigned after power-up."""
