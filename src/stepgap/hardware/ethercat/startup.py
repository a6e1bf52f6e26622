"""Objects that the master writes by SDO before a slave exchanges process data, and reads back."""

import re
from dataclasses import dataclass
from struct import Struct
from types import MappingProxyType
from typing import Protocol

from stepgap.base.ranges import format_value, require
from stepgap.rigs.rig import RigFault

LAYOUTS = MappingProxyType(
    {
        "INT8": Struct("<b"),
        "UINT8": Struct("<B"),
        "INT16": Struct("<h"),
        "UINT16": Struct("<H"),
        "INT32": Struct("<i"),
        "UINT32": Struct("<I"),
        "REAL32": Struct("<f"),
    }
)
"""Types of an object (CiA 301, data types), with their bytes."""

WRITTEN_OBJECT = re.compile(r"(0x[0-9a-f]{4}):([0-9a-f]{2}) +([A-Z]+[0-9]+) *= *(\S+)", re.IGNORECASE)

_RESERVED = ((0x1600, 0x1BFF), (0x1C00, 0x1C3F), (0x6040, 0x6040), (0x6060, 0x6060), (0x6071, 0x6072))
"""Ranges of objects that the master sets itself: PDOs, sync managers, controlword, mode, torque and its limit."""


class Objects(Protocol):
    """Access to the objects of slaves by SDO, as `Bus` gives it."""

    def label(self, number: int, /) -> str:
        """Name of a slave for messages."""
        ...

    def read_object(self, number: int, index: int, layout: Struct, subindex: int = 0, /) -> int:
        """Reads an object."""
        ...

    def write_object(self, number: int, index: int, layout: Struct, value: float, subindex: int = 0, /) -> None:
        """Writes an object."""
        ...


@dataclass(frozen=True)
class StartupObject:
    """An object and the value that it must have.

    Attributes:
        index: Its index.
        subindex: Its subindex.
        kind: Its type, a key of `LAYOUTS`.
        value: Its value.
    """

    index: int
    subindex: int
    kind: str
    value: float

    @classmethod
    def parse(cls, text: str) -> "StartupObject":
        """Parses `0xINDEX:SUB TYPE = VALUE`, subindex in hexadecimal.

        Raises:
            ValueError: The text has another form, the value does not fit the type, or the master sets this object.
        """
        match = WRITTEN_OBJECT.fullmatch(text.strip())
        if match is None:
            raise ValueError(f"'{text[:60]}' is not an object; write it as '0x3034:00 UINT16 = 5'")
        index = int(match[1], 16)
        subindex = int(match[2], 16)
        kind = match[3].upper()
        if kind not in LAYOUTS:
            raise ValueError(f"{match[3]} is not a type; these are {', '.join(LAYOUTS)}")
        if is_reserved(index):
            raise ValueError(f"0x{index:04X} is set by the master, from other keys of this file")
        try:
            value = float(match[4]) if kind == "REAL32" else int(match[4], 0)
            LAYOUTS[kind].pack(value)
        except Exception as error:  # struct.error, ValueError or OverflowError
            raise ValueError(f"{match[4][:40]} is not a number that fits {kind}") from error
        return cls(index, subindex, kind, value)

    def __str__(self) -> str:
        return f"0x{self.index:04X}:{self.subindex:02X} {self.kind} = {self.value:g}"


def is_reserved(index: int) -> bool:
    """Whether the master sets an object itself, so that it cannot be a startup object."""
    return any(low <= index <= high for low, high in _RESERVED)


def require_objects(texts: tuple[str, ...]) -> None:
    """Raises ValueError unless each text describes an object, and none describes the same one again."""
    parsed = []
    for text in texts:
        try:
            parsed.append(StartupObject.parse(text))
        except ValueError as error:
            raise ValueError(f"startup = {format_value(text)}, but it must be an object: {error}") from None
    addresses = [(startup.index, startup.subindex) for startup in parsed]
    require(len(set(addresses)) == len(addresses), "startup", list(texts), "name each object once")


def write_startup(bus: Objects, number: int, wanted: StartupObject) -> None:
    """Writes an object of a slave and reads it back.

    Raises:
        RigFault: The slave refuses it, or has another value afterwards.
    """
    layout = LAYOUTS[wanted.kind]
    bus.write_object(number, wanted.index, layout, wanted.value, wanted.subindex)
    answer = bus.read_object(number, wanted.index, layout, wanted.subindex)
    if layout.pack(answer) != layout.pack(wanted.value):
        raise RigFault(
            f"{bus.label(number)}: object 0x{wanted.index:04X}:{wanted.subindex:02X} is {answer:g} "
            f"after {wanted.value:g} was written"
        )
