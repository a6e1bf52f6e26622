"""Layout of the process data: which object is where in the bytes that a slave exchanges every cycle."""

import re
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from struct import Struct
from typing import Self

from stepgap.hardware.ethercat.startup import Objects
from stepgap.rigs.rig import RigFault

SIGNED_VALUES = {
    "controlword": False,
    "target_torque": True,
    "mode": True,
    "statusword": False,
    "position": True,
    "velocity": True,
    "torque": True,
    "mode_display": True,
    "error_code": False,
    "temperature": True,
    "bus_voltage": False,
    "digital_inputs": False,
    "counter": True,
    "force": True,
    "status": False,
}
"""The values that a rig knows, and whether each is signed. An unsigned counter is read as signed: it is unwrapped.

A rig ignores those that it does not use, such as the digital inputs of a drive.

The status word of a terminal consists of many objects of one bit, so its entry is written as padding with a name.
"""

ENTRY_FORMATS = {8: "b", 16: "h", 32: "i"}

WRITTEN_ENTRY = re.compile(r"(0x[0-9a-f]{4}):([0-9a-f]{2}):(\d{1,2})(?: +([a-z_]+))?", re.IGNORECASE)


@dataclass(frozen=True)
class Entry:
    """One object in a PDO.

    Attributes:
        index: Index of the object; 0 for padding and for a status word.
        subindex: Subindex of the object.
        bits: Its size.
        name: Its name in the rig, one of `SIGNED_VALUES`; empty if the rig does not use it.

    Raises:
        ValueError: Size or name are not valid.
    """

    index: int
    subindex: int
    bits: int
    name: str = ""

    def __post_init__(self) -> None:
        if self.name and self.name not in SIGNED_VALUES:
            raise ValueError(f"{self.name} is not a value of a rig; these are {', '.join(SIGNED_VALUES)}")
        if self.bits not in ENTRY_FORMATS and (self.name or not 0 < self.bits <= 64):
            raise ValueError(f"{self} has {self.bits} bits, but it must have 8, 16 or 32, or 1 to 64 without a name")

    @property
    def word(self) -> int:
        """Number that stands for it in the object of a PDO: index, subindex and size."""
        return self.index << 16 | self.subindex << 8 | self.bits

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X}:{self.bits}" + (f" {self.name}" if self.name else "")

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parses an entry `0xINDEX:SUB:BITS NAME`, subindex in hexadecimal; the name may be omitted.

        Raises:
            ValueError: The text has another form.
        """
        match = WRITTEN_ENTRY.fullmatch(text)
        if match is None:
            raise ValueError(f"'{text[:60]}' is not an entry; write it as '0x6041:00:16 statusword'")
        index, subindex, bits, name = match.groups()
        return cls(int(index, 16), int(subindex, 16), int(bits), name or "")


@dataclass(frozen=True)
class Pdo:
    """A process data object: its index and its entries, in order."""

    index: int
    entries: tuple[Entry, ...]


class Packing:
    """Conversion of consecutive PDOs to bytes and back; little-endian, with a fixed length.

    Args:
        pdos: The PDOs in the order of their assignment.

    Raises:
        ValueError: A named value does not start at a byte, a name occurs twice, or the PDOs do not fill bytes.
    """

    def __init__(self, pdos: tuple[Pdo, ...]):
        entries = [entry for pdo in pdos for entry in pdo.entries]
        self.names = tuple(entry.name for entry in entries if entry.name)
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"a value is mapped twice: {', '.join(self.names)}")
        self.mapping: dict[str, tuple[Entry, int]] = {}
        """Entry and first bit of each named value."""
        codes = "<"
        bit = 0
        for entry in entries:
            if entry.name:
                self.mapping[entry.name] = (entry, bit)
                if bit % 8:
                    raise ValueError(f"{entry} starts at bit {bit}, but it must start at a byte")
                code = ENTRY_FORMATS[entry.bits]
                codes += code if SIGNED_VALUES[entry.name] else code.upper()
            else:
                codes += "x" * ((bit + entry.bits) // 8 - bit // 8)
            bit += entry.bits
        if bit % 8:
            raise ValueError(f"the PDOs have {bit} bits, but they must fill bytes")
        self._struct = struct.Struct(codes)
        assert self._struct.size == bit // 8
        self.size = self._struct.size

    def pack(self, values: Mapping[str, int]) -> bytes:
        """Packs all named values into exactly `size` bytes.

        Raises:
            struct.error: A value does not fit.
            KeyError: A value is missing.
        """
        return self._struct.pack(*[values[name] for name in self.names])

    def unpack(self, data: bytes) -> dict[str, int]:
        """Unpacks the named values from the bytes.

        Raises:
            struct.error: There are more or fewer bytes than `size`.
        """
        return dict(zip(self.names, self._struct.unpack(data), strict=True))


@dataclass(frozen=True)
class PdoSet:
    """The PDOs that a slave exchanges: outputs of the master (0x1C12) and inputs (0x1C13).

    Raises:
        ValueError: They cannot be packed.
    """

    outputs: tuple[Pdo, ...] = ()
    inputs: tuple[Pdo, ...] = ()

    def __post_init__(self) -> None:
        for pdos in (self.outputs, self.inputs):
            Packing(pdos)


_U8 = Struct("<B")
_U16 = Struct("<H")
_U32 = Struct("<I")


def configure_pdos(bus: Objects, number: int, assignment: int, pdos: tuple[Pdo, ...]) -> None:
    """Assigns PDOs to a sync manager and writes their contents where they differ from the wanted ones.

    Args:
        bus: Access to the slave, in PREOP.
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
    packing = Packing(pdos)
    mapped = dict[int, tuple[int, int, int]]()
    bit = 0
    for pdo in pdos:
        for subindex in range(1, bus.read_object(number, pdo.index, _U8) + 1):
            word = bus.read_object(number, pdo.index, _U32, subindex)
            bits = word & 0xFF
            mapped[bit] = (word >> 16, word >> 8 & 0xFF, bits)
            bit += bits
    for entry, at in packing.mapping.values():
        if entry.index and mapped.get(at) != (entry.index, entry.subindex, entry.bits):
            there = "0x{:04X}:{:02X}:{}".format(*mapped[at]) if at in mapped else "none"
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
            bus.write_object(number, pdo.index, _U32, entry.word, subindex)
        bus.write_object(number, pdo.index, _U8, len(pdo.entries))
    assign_pdos(bus, number, assignment, pdos)
