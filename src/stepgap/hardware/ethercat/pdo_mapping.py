"""PDOs of a slave over SDO: which ones a sync manager has, and which objects they contain (ETG.1000.6, CiA 301)."""

from struct import Struct

from stepgap.hardware.ethercat.pdo import Packing, Pdo
from stepgap.hardware.ethercat.startup import Objects
from stepgap.rigs.rig import RigFault

_U8, _U16, _U32 = Struct("<B"), Struct("<H"), Struct("<I")


def configure_pdos(bus: Objects, number: int, assignment: int, pdos: tuple[Pdo, ...]) -> None:
    """Assigns PDOs to a sync manager and writes their contents where they differ from the wanted ones.

    Args:
        bus: Access to the slave, in PREOP.
        number: Number of the slave.
        assignment: Object of the sync manager, 0x1C12 or 0x1C13.
        pdos: The PDOs in their order.

    Raises:
        RigFault: The slave exchanges something else, and refuses to change it.
    """
    assign_pdos(bus, number, assignment, pdos)
    fault = mapping_fault(bus, number, pdos)
    if not fault:
        return
    try:
        _map(bus, number, assignment, pdos)
    except RigFault as refusal:
        raise RigFault(f"{fault}, and it cannot be changed: {refusal}") from None
    if fault := mapping_fault(bus, number, pdos):
        raise RigFault(fault)


def assign_pdos(bus: Objects, number: int, assignment: int, pdos: tuple[Pdo, ...]) -> None:
    """Assigns PDOs that are not assigned already; some terminals have only one set and refuse the assignment."""
    count = bus.read_object(number, assignment, _U8)
    present = [bus.read_object(number, assignment, _U16, subindex) for subindex in range(1, count + 1)]
    if present == [pdo.index for pdo in pdos]:
        return
    bus.write_object(number, assignment, _U8, 0)
    for subindex, pdo in enumerate(pdos, start=1):
        bus.write_object(number, assignment, _U16, pdo.index, subindex)
    bus.write_object(number, assignment, _U8, len(pdos))


def mapping_fault(bus: Objects, number: int, pdos: tuple[Pdo, ...]) -> str:
    """Compares the contents of the slave's PDOs with the wanted ones: the position of each value used, and the length.

    Returns:
        What differs; empty if nothing does.
    """
    packing, found, bit = Packing(pdos), dict[int, tuple[int, int, int]](), 0
    for pdo in pdos:
        for subindex in range(1, bus.read_object(number, pdo.index, _U8) + 1):
            word = bus.read_object(number, pdo.index, _U32, subindex)
            bits = word & 0xFF
            found[bit] = (word >> 16, word >> 8 & 0xFF, bits)
            bit += bits
    for entry, at in packing.mapping.values():
        if entry.index and found.get(at) != (entry.index, entry.subindex, entry.bits):
            there = "0x{:04X}:{:02X}:{}".format(*found[at]) if at in found else "none"
            return f"{bus.label(number)} must map {entry} at byte {at // 8}, but there is {there}"
    if bit != 8 * packing.size:
        indices = ", ".join(f"0x{pdo.index:04X}" for pdo in pdos)
        return f"{bus.label(number)} must map {packing.size} bytes in {indices}, but maps {bit / 8:g}"
    return ""


def _map(bus: Objects, number: int, assignment: int, pdos: tuple[Pdo, ...]) -> None:
    """Writes the contents of PDOs, which must not be assigned meanwhile; a slave whose PDOs are fixed refuses this."""
    bus.write_object(number, assignment, _U8, 0)
    for pdo in pdos:
        bus.write_object(number, pdo.index, _U8, 0)
        for subindex, entry in enumerate(pdo.entries, start=1):
            word = entry.index << 16 | entry.subindex << 8 | entry.bits
            bus.write_object(number, pdo.index, _U32, word, subindex)
        bus.write_object(number, pdo.index, _U8, len(pdo.entries))
    assign_pdos(bus, number, assignment, pdos)
