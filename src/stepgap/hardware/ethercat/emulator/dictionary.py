"""The object dictionary of a slave, and its process data (ETG.1000.6 §5.6, CiA 301)."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

from stepgap.base.errors import StepGapError
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.hardware.ethercat.pdo import Pdo

DEVICE_TYPE = 0x1000
DEVICE_NAME = 0x1008
IDENTITY = 0x1018
SYNC_MANAGER_TYPES = 0x1C00
ASSIGN_OUTPUTS = 0x1C12
ASSIGN_INPUTS = 0x1C13
"""Communication area (ETG.1000.6): device, kinds of the sync managers, PDOs in them."""

MOST_PDOS = 8  # Largest number of PDOs in a sync manager
MOST_PARTS = 16  # Largest number of entries in a PDO


class Abort(StepGapError):
    """Refusal of an SDO request, with a code (ETG.1000.6, SDO abort codes)."""

    UNKNOWN_COMMAND = 0x05040001
    TOO_LONG = 0x06070010
    UNSUPPORTED_ACCESS = 0x06010000
    READ_ONLY = 0x06010002
    ASSIGNED_STILL = 0x06010003
    NO_OBJECT = 0x06020000
    NOT_MAPPABLE = 0x06040041
    NO_SUBINDEX = 0x06090011
    VALUE_RANGE = 0x06090030
    WRONG_STATE = 0x08000022

    def __init__(self, code: int):
        super().__init__(f"{code:#010x}")
        self.code = code


@dataclass(slots=True)
class ObjectEntry:
    """One value of the dictionary.

    Attributes:
        value: The number.
        bits: Its size.
        signed: Whether the number may be negative.
        writable: Whether SDO may write it.
        text: ASCII text instead of a number.
    """

    value: int
    bits: int
    signed: bool = False
    writable: bool = False
    text: bytes = b""

    def encoded(self) -> bytes:
        """Encodes the value as little-endian bytes for an SDO."""
        if self.text:
            return self.text
        size = (self.bits + 7) // 8
        return (self.value & (1 << 8 * size) - 1).to_bytes(size, "little")


class Image:
    """Process data as bytes: the consecutive entries of the assigned PDOs, lowest bit first.

    Args:
        parts: Entry and number of bits of each part; the entry of padding is None.
    """

    def __init__(self, parts: Iterable[tuple[ObjectEntry | None, int]]):
        self._fields = []
        shift = 0
        for entry, bits in parts:
            if entry is not None:
                self._fields.append((entry, (1 << bits) - 1, shift))
            shift += bits
        self.length = (shift + 7) // 8
        """Length [bytes]."""

    def pack(self) -> bytes:
        """Packs the present values of the entries."""
        word = 0
        for entry, mask, shift in self._fields:
            word |= (entry.value & mask) << shift
        return word.to_bytes(self.length, "little")

    def unpack(self, data: bytes) -> None:
        """Sets the entries to the values in `data`."""
        word = int.from_bytes(data, "little")
        for entry, mask, shift in self._fields:
            value = word >> shift & mask
            entry.value = value - mask - 1 if entry.signed and value > mask >> 1 else value


class Dictionary:
    """Objects of a slave: its identity, its PDOs, and those of its application.

    Args:
        identity: Objects 0x1008 and 0x1018.
        objects: The application's entries by index and subindex.
        outputs: PDOs that may be assigned to sync manager 2, and at first those of `assigned_outputs` are.
        inputs: PDOs that may be assigned to sync manager 3, and at first those of `assigned_inputs` are.
        check: Raises `Abort` if a number must not be written to an index.
        mappable: Whether the contents of PDOs may be written while they are not assigned.
    """

    def __init__(
        self,
        identity: Identity,
        objects: Mapping[tuple[int, int], ObjectEntry],
        outputs: tuple[Pdo, ...],
        inputs: tuple[Pdo, ...],
        assigned_outputs: tuple[int, ...],
        assigned_inputs: tuple[int, ...],
        check: Callable[[int, int], None] = lambda index, value: None,
        mappable: bool = False,
    ):
        self._entries: dict[tuple[int, int], ObjectEntry] = {
            (DEVICE_TYPE, 0): ObjectEntry(0, 32),
            (DEVICE_NAME, 0): ObjectEntry(0, 0, text=identity.name.encode("ascii")),
            **_array(IDENTITY, (identity.vendor, identity.product, identity.revision, identity.serial), 32),
            **_array(SYNC_MANAGER_TYPES, (1, 2, 3, 4), 8),
            **_array(ASSIGN_OUTPUTS, assigned_outputs, 16, MOST_PDOS),
            **_array(ASSIGN_INPUTS, assigned_inputs, 16, MOST_PDOS),
            **objects,
        }
        self._pdos = {ASSIGN_OUTPUTS: {pdo.index for pdo in outputs}, ASSIGN_INPUTS: {pdo.index for pdo in inputs}}
        self._check = check
        self._mappable = mappable
        for pdo in (*outputs, *inputs):
            self._entries |= _array(pdo.index, tuple(entry.word for entry in pdo.entries), 32, MOST_PARTS)

    def read(self, index: int, subindex: int) -> bytes:
        """Reads the bytes of an entry.

        Raises:
            Abort: There is no such entry.
        """
        return self._find(index, subindex).encoded()

    def write(self, index: int, subindex: int, data: bytes, may_assign: bool) -> None:
        """Sets an entry from its bytes.

        Args:
            data: Value, little-endian, as long as the entry.
            may_assign: Whether the slave is in a state where PDOs may be assigned (PREOP).

        Raises:
            Abort: The entry cannot be written, not in this state, or not with this value.
        """
        entry = self._find(index, subindex)
        if index in self._pdos:
            if not may_assign:
                raise Abort(Abort.WRONG_STATE)
            self._check_assignment(index, subindex, int.from_bytes(data, "little"))
        elif self._mappable and any(index in pdos for pdos in self._pdos.values()):
            if not may_assign:
                raise Abort(Abort.WRONG_STATE)
            self._check_mapping(index, subindex, int.from_bytes(data, "little"))
        elif not entry.writable:
            raise Abort(Abort.READ_ONLY)
        if 8 * len(data) != entry.bits:
            raise Abort(Abort.TOO_LONG)
        value = int.from_bytes(data, "little", signed=entry.signed)
        self._check(index, value)
        entry.value = value

    def image(self, assignment: int) -> Image:
        """Process data of ASSIGN_OUTPUTS or ASSIGN_INPUTS with the present assignment."""
        parts = []
        for number in range(1, self._number(assignment, 0) + 1):
            pdo = self._number(assignment, number)
            for subindex in range(1, self._number(pdo, 0) + 1):
                word = self._number(pdo, subindex)
                parts.append((self._entries[word >> 16, word >> 8 & 0xFF] if word >> 16 else None, word & 0xFF))
        return Image(parts)

    def _check_assignment(self, index: int, subindex: int, value: int) -> None:
        """Checks an assignment: first the count is cleared, then PDOs are written, then the count (ETG.1020)."""
        if subindex == 0:
            if value > MOST_PDOS:
                raise Abort(Abort.VALUE_RANGE)
            assigned = [self._number(index, number) for number in range(1, value + 1)]
            if not all(pdo in self._pdos[index] for pdo in assigned):
                raise Abort(Abort.NOT_MAPPABLE)
        elif self._number(index, 0) != 0:
            raise Abort(Abort.ASSIGNED_STILL)
        elif value not in self._pdos[index]:
            raise Abort(Abort.NOT_MAPPABLE)

    def _check_mapping(self, index: int, subindex: int, value: int) -> None:
        """Checks the content of a PDO, which is written like an assignment, while the PDO is not assigned."""
        for assignment in self._pdos:
            if index in [self._number(assignment, number + 1) for number in range(self._number(assignment, 0))]:
                raise Abort(Abort.ASSIGNED_STILL)
        if subindex == 0:
            if value > MOST_PARTS:
                raise Abort(Abort.VALUE_RANGE)
        elif self._number(index, 0) != 0:
            raise Abort(Abort.ASSIGNED_STILL)
        elif value >> 16:
            mapped = self._entries.get((value >> 16, value >> 8 & 0xFF))
            if mapped is None or mapped.bits != value & 0xFF:
                raise Abort(Abort.NOT_MAPPABLE)

    def _number(self, index: int, subindex: int) -> int:
        return self._entries[index, subindex].value

    def _find(self, index: int, subindex: int) -> ObjectEntry:
        entry = self._entries.get((index, subindex))
        if entry is None:
            raise Abort(Abort.NO_SUBINDEX if (index, 0) in self._entries else Abort.NO_OBJECT)
        return entry


def _array(index: int, values: tuple[int, ...], bits: int, most: int = 0) -> dict[tuple[int, int], ObjectEntry]:
    """Creates an object of equal entries, whose subindex 0 is their count, with space for `most`."""
    entries = {(index, 0): ObjectEntry(len(values), 8)}
    for number in range(max(len(values), most)):
        entries[index, number + 1] = ObjectEntry(values[number] if number < len(values) else 0, bits)
    return entries
