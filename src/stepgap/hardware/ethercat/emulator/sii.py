"""The slave information interface: the EEPROM by which a master identifies a slave (ETG.1000.6 §5.4, ETG.2010)."""

from dataclasses import dataclass
from struct import pack

# Categories, from word 0x40 on (ETG.2010, category types).
STRINGS = 10
GENERAL = 30
FMMU_USE = 40
SYNC_MANAGERS = 41
END = 0xFFFF

CANOPEN = 0x04  # Bit of the mailbox protocols in word 0x1C: CANopen over EtherCAT
SDO = 0x01  # Bit of GENERAL's CoE details: SDOs are supported
PDO_ASSIGN = 0x04  # Bit of GENERAL's CoE details: 0x1C12 and 0x1C13 may be written
SPI = 0x05  # Interface of the slave controller to its device, in the lowest byte: SPI; 0 is none
CHECKED = 14  # Length of the configuration that a checksum follows [bytes]
FIRST_CATEGORY = 0x80  # Byte address of the first category


@dataclass(frozen=True)
class Identity:
    """Identity of a slave, in the EEPROM and in object 0x1018 (ETG.1000.6, identity object).

    Attributes:
        name: Name of the product, ASCII, in the EEPROM and in object 0x1008.
        vendor: Vendor number given by the EtherCAT Technology Group.
        product: The vendor's product code.
        revision: Revision of the product.
        serial: Serial number.
    """

    name: str
    vendor: int
    product: int
    revision: int = 0x00010000
    serial: int = 1


@dataclass(frozen=True)
class Area:
    """A sync manager as the EEPROM proposes it.

    Attributes:
        start: First byte in the slave's memory.
        length: Length [bytes].
        control: Register 4 of the sync manager: buffer or mailbox, direction, watchdog.
        use: 1 mailbox in, 2 mailbox out, 3 outputs, 4 inputs.
    """

    start: int
    length: int
    control: int
    use: int


MAILBOX_AREAS = (Area(0x1000, 128, 0x26, 1), Area(0x1080, 128, 0x22, 2))
OUTPUT_START = 0x1100
INPUT_START = 0x1180
OUTPUT_CONTROL = 0x64  # Three buffers, which trigger the watchdog
INPUT_CONTROL = 0x20  # Three buffers


def build_image(identity: Identity, areas: tuple[Area, ...]) -> bytes:
    """Builds the content of a slave's EEPROM; `areas` is empty for a slave without mailbox and process data."""
    fixed = bytearray(FIRST_CATEGORY)
    fixed[0] = SPI if areas else 0
    fixed[CHECKED] = checksum(bytes(fixed[:CHECKED]))
    fixed[0x10:0x20] = pack("<IIII", identity.vendor, identity.product, identity.revision, identity.serial)
    if areas:
        incoming, outgoing = areas[:2]
        mailboxes = pack("<HHHHH", incoming.start, incoming.length, outgoing.start, outgoing.length, CANOPEN)
        fixed[0x30:0x3A] = mailboxes
    fixed[0x7C:0x80] = pack("<HH", 0x000F, 1)  # 16 kbit, version 1
    text = identity.name.encode("ascii")
    general = bytes([0, 0, 1, 1, 0, (SDO | PDO_ASSIGN) if areas else 0]).ljust(32, b"\0")
    managers = b"".join(
        pack("<HHBBBB", area.start, area.length, area.control, 0, area.length > 0, area.use) for area in areas
    )
    return (
        bytes(fixed)
        + _category(STRINGS, bytes([1, len(text)]) + text)
        + _category(GENERAL, general)
        + (_category(FMMU_USE, bytes([1, 2])) + _category(SYNC_MANAGERS, managers) if areas else b"")
        + pack("<H", END)
    )


def checksum(configuration: bytes) -> int:
    """CRC-8 of the configuration: polynomial x⁸ + x² + x + 1, initial value 0xFF (IEC 61158-6-12 §5.4)."""
    rest = 0xFF
    for byte in configuration:
        rest ^= byte
        for _ in range(8):
            rest = rest << 1 ^ (0x107 if rest & 0x80 else 0)
    return rest


def _category(kind: int, content: bytes) -> bytes:
    content += b"\0" * (len(content) % 2)
    return pack("<HH", kind, len(content) // 2) + content
