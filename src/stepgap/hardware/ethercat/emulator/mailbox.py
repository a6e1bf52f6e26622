"""CANopen over EtherCAT in a slave's mailbox: answers to SDO requests, and emergencies (ETG.1000.6 §5.6)."""

from collections import deque
from collections.abc import Iterable
from struct import Struct, pack, unpack_from

from stepgap.hardware.ethercat.emulator import registers as reg
from stepgap.hardware.ethercat.emulator.dictionary import Abort, Dictionary

_MANAGER = reg.SYNC_MANAGER + reg.SYNC_MANAGER_SIZE  # Registers of sync manager 1, that of the outgoing mailbox


def mailbox_area(memory: bytearray, number: int) -> tuple[int, int, bool]:
    """Start, length and full flag of sync manager 0 or 1; length 0 if it is off or not in free memory."""
    base = reg.SYNC_MANAGER + number * reg.SYNC_MANAGER_SIZE
    start, length, _, status, active = unpack_from("<HHBBB", memory, base)
    on = active & reg.SYNC_MANAGER_ENABLED and reg.PROCESS_RAM <= start <= reg.MEMORY_SIZE - length
    return start, length if on else 0, bool(status & reg.MAILBOX_FULL)


class OutgoingMail:
    """Messages from a slave to the master, one after the other in the outgoing mailbox of its memory."""

    def __init__(self, memory: bytearray):
        self._memory = memory
        self._waiting = deque[bytes]()
        self._sent = b""
        self._counter = 0

    def add(self, messages: Iterable[bytes]) -> None:
        """Adds messages, the first of which is put into the mailbox if that is empty."""
        self._waiting += messages
        self._load()

    def clear(self) -> None:
        """Forgets the messages that wait."""
        self._waiting.clear()

    def taken(self) -> None:
        """Puts the next message into the mailbox, of which the master has read the last byte."""
        self._memory[_MANAGER + 5] &= ~reg.MAILBOX_FULL
        self._load()

    def repeat(self) -> None:
        """Repeats the last answer if the master toggled the repeat bit, since it lost that answer; echoes the bit."""
        if (self._memory[_MANAGER + 6] ^ self._memory[_MANAGER + 7]) & reg.REPEAT:
            start, length, _ = mailbox_area(self._memory, 1)
            if length and self._sent:
                self._put(self._sent, start, length)
            self._memory[_MANAGER + 7] ^= reg.REPEAT

    def _load(self) -> None:
        """Puts the next message into the mailbox if it is empty."""
        start, length, full = mailbox_area(self._memory, 1)
        if self._waiting and length and not full:
            message = bytearray(self._waiting.popleft())
            self._counter = self._counter % 7 + 1
            message[5] |= self._counter << 4
            self._put(bytes(message), start, length)

    def _put(self, message: bytes, start: int, length: int) -> None:
        self._sent = message
        self._memory[start : start + length] = message.ljust(length, b"\0")[:length]
        self._memory[_MANAGER + 5] |= reg.MAILBOX_FULL


# Mailbox types (ETG.1000.4, mailbox header).
MAILBOX_ERROR = 0
COE = 3

# CoE services (ETG.1000.6, CoE header). An abort is a request, also from a slave.
EMERGENCY = 1
SDO_REQUEST = 2
SDO_RESPONSE = 3
PDO_REQUEST = 7
SDO_INFORMATION = 8

# Commands in the SDO command byte, their mask, and flags (ETG.1000.6, SDO services).
UPLOAD = 0x40
DOWNLOAD = 0x20
DOWNLOADED = 0x60
ABORT = 0x80
COMMAND_MASK = 0xE0
EXPEDITED = 0x02
SIZE_GIVEN = 0x01
COMPLETE = 0x10

INFORMATION_ERROR = 7
"""Operation code of the answer that refuses a request for information on objects (ETG.1000.6, SDO information)."""

# Details of a mailbox error: type or service not supported, wrong header, too short for its service (ETG.1000.4).
UNSUPPORTED_PROTOCOL = 0x0002
UNSUPPORTED_SERVICE = 0x0004
INVALID_HEADER = 0x0005
TOO_SHORT = 0x0006

_HEADER = Struct("<HHBB")
_SDO = Struct("<HBHB")
_INFORMATION_ERROR = Struct("<HBBHI")


def answer(dictionary: Dictionary, request: bytes, may_assign: bool, room: int) -> bytes | None:
    """Answers a mailbox message.

    Args:
        request: Mailbox message of a master; it may contain arbitrary bytes.
        may_assign: Whether PDOs may be assigned in the present state.
        room: Longest answer [bytes]; longer objects are refused, since segments are not supported.

    Returns:
        The answer; None to an abort, which is not confirmed (CiA 301).
    """
    length, _, _, kind = _HEADER.unpack_from(request.ljust(_HEADER.size, b"\0"))
    if not length or kind & 0x0F == MAILBOX_ERROR:
        return _error(INVALID_HEADER)
    if kind & 0x0F != COE:
        return _error(UNSUPPORTED_PROTOCOL)
    body = request[_HEADER.size : _HEADER.size + length]
    if len(body) < _SDO.size:
        return _error(TOO_SHORT)
    coe, command, index, subindex = _SDO.unpack_from(body)
    service = coe >> 12
    if service == SDO_INFORMATION:
        refusal = SDO_INFORMATION << 12, INFORMATION_ERROR, 0, 0, Abort.UNKNOWN_COMMAND
        return _message(COE, _INFORMATION_ERROR.pack(*refusal))
    if service != SDO_REQUEST:
        return _error(UNSUPPORTED_SERVICE if EMERGENCY <= service <= PDO_REQUEST else INVALID_HEADER)
    if command & COMMAND_MASK == ABORT:
        return None
    try:
        answered, value = _served(dictionary, command, index, subindex, body[_SDO.size :], may_assign, room)
        return _sdo(SDO_RESPONSE, index, subindex, answered, value)
    except Abort as abort:
        return _sdo(SDO_REQUEST, index, subindex, ABORT, pack("<I", abort.code))


def _served(
    dictionary: Dictionary, command: int, index: int, subindex: int, data: bytes, may_assign: bool, room: int
) -> tuple[int, bytes]:
    """Command and data of the answer to an SDO request."""
    if command & COMPLETE and command & COMMAND_MASK in (UPLOAD, DOWNLOAD):
        raise Abort(Abort.UNSUPPORTED_ACCESS)
    if command & COMMAND_MASK == UPLOAD:
        return _uploaded(dictionary.read(index, subindex), room)
    if command & COMMAND_MASK == DOWNLOAD:
        dictionary.write(index, subindex, _downloaded(command, data), may_assign)
        return DOWNLOADED, bytes(4)
    raise Abort(Abort.UNKNOWN_COMMAND)


def emergency(code: int, register: int) -> bytes:
    """Encodes an emergency message (ETG.1000.6, emergency service): error code (0x603F) and error register (0x1001)."""
    return _message(COE, pack("<HHB5x", EMERGENCY << 12, code, register))


def _uploaded(value: bytes, room: int) -> tuple[int, bytes]:
    """Command and data of an upload: at most four bytes are expedited."""
    if len(value) <= 4:
        return UPLOAD | EXPEDITED | SIZE_GIVEN | (4 - len(value)) << 2, value.ljust(4, b"\0")
    if _HEADER.size + _SDO.size + 4 + len(value) > room:
        raise Abort(Abort.TOO_LONG)
    return UPLOAD | SIZE_GIVEN, pack("<I", len(value)) + value


def _downloaded(command: int, data: bytes) -> bytes:
    if command & EXPEDITED:
        return data[: 4 - (command >> 2 & 3) if command & SIZE_GIVEN else 4]
    size = int.from_bytes(data[:4], "little")
    if size != len(data) - 4:
        raise Abort(Abort.TOO_LONG)
    return data[4:]


def _error(detail: int) -> bytes:
    return _message(MAILBOX_ERROR, pack("<HH", 1, detail))


def _sdo(service: int, index: int, subindex: int, command: int, data: bytes) -> bytes:
    return _message(COE, _SDO.pack(service << 12, command, index, subindex) + data)


def _message(kind: int, body: bytes) -> bytes:
    """Encodes a mailbox message; the slave sets its counter when it is sent (bits 4–6 of the type byte)."""
    return _HEADER.pack(len(body), 0, 0, kind) + body
