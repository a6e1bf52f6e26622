"""EtherCAT frames and the datagrams in them (ETG.1000.4 §5.3, §5.4)."""

from enum import IntEnum
from struct import Struct
from typing import NamedTuple

from stepgap.base.errors import StepGapError

ETHERTYPE = 0x88A4
BROADCAST = b"\xff" * 6
SHORTEST_FRAME = 60  # Least length of an Ethernet frame without check sequence [bytes]; shorter ones are padded
LONGEST_FRAME = 1514

_ETHERNET = Struct("!6s6sH")
_ETHERCAT = Struct("<H")
_DATAGRAM = Struct("<BBHHHH")
_COUNTER = Struct("<H")
_BEGIN = _ETHERNET.size + _ETHERCAT.size
_LENGTH_MASK = 0x07FF
_MORE_FOLLOW = 0x8000
_DATAGRAMS = 0x1000


class FrameError(StepGapError, ValueError):
    """The bytes are not an EtherCAT frame with datagrams."""


class Command(IntEnum):
    """Commands of a datagram (ETG.1000.4 §5.4.1): by position (AP), station (FP), broadcast (B), logical (L)."""

    NOP = 0
    APRD = 1
    APWR = 2
    APRW = 3
    FPRD = 4
    FPWR = 5
    FPRW = 6
    BRD = 7
    BWR = 8
    BRW = 9
    LRD = 10
    LWR = 11
    LRW = 12
    ARMW = 13
    FRMW = 14


class Datagram(NamedTuple):
    """One command to the slaves, and their answer.

    Attributes:
        command: A `Command`; others are passed on.
        mark: Index by which the master identifies the answer.
        address: Position or station address; the low half of a logical address.
        offset: Register or memory address; the high half of a logical address.
        data: Data to be written, or data read.
        counter: Working counter: number of accesses by slaves (+1 read, +1 written, +2 written by LRW).
        flags: Reserved and circulating bits of the length field, kept unchanged.
        event: Event field, kept unchanged.
    """

    command: int
    mark: int
    address: int
    offset: int
    data: bytes
    counter: int = 0
    flags: int = 0
    event: int = 0


class Frame(NamedTuple):
    """An Ethernet frame of EtherCAT datagrams."""

    destination: bytes
    source: bytes
    datagrams: tuple[Datagram, ...]


def decode(raw: bytes) -> Frame:
    """Decodes the datagrams in an Ethernet frame.

    Raises:
        FrameError: It is not EtherCAT, or it is truncated.
    """
    start = _BEGIN
    if len(raw) < start:
        raise FrameError(f"{len(raw)} bytes are too few for a frame")
    destination, source, kind = _ETHERNET.unpack_from(raw)
    (header,) = _ETHERCAT.unpack_from(raw, _ETHERNET.size)
    end = start + (header & _LENGTH_MASK)
    if kind != ETHERTYPE or header & 0xF000 != _DATAGRAMS:
        raise FrameError(f"type {kind:#06x} with header {header:#06x} is not that of EtherCAT datagrams")
    if end > len(raw):
        raise FrameError("the frame is shorter than the length in its header")
    datagrams = []
    more = True
    while more:
        data_start = start + _DATAGRAM.size
        if data_start > end:
            raise FrameError("the header of a datagram is truncated")
        command, mark, address, offset, length, event = _DATAGRAM.unpack_from(raw, start)
        data_end = data_start + (length & _LENGTH_MASK)
        if data_end + _COUNTER.size > end:
            raise FrameError("the data of a datagram are truncated")
        (counter,) = _COUNTER.unpack_from(raw, data_end)
        flags = length & ~_LENGTH_MASK & ~_MORE_FOLLOW
        more = bool(length & _MORE_FOLLOW)
        data = bytes(raw[data_start:data_end])
        datagrams.append(Datagram(command, mark, address, offset, data=data, counter=counter, flags=flags, event=event))
        start = data_end + _COUNTER.size
    return Frame(destination, source, tuple(datagrams))


def encode(frame: Frame, received: bytes = b"") -> bytes:
    """Encodes an Ethernet frame, padded to the least length.

    Args:
        received: What the frame was decoded from, if it is passed on: its length, and all bytes that belong to no
            datagram, remain, as with slave controllers.
    """
    parts = []
    for remaining, datagram in zip(range(len(frame.datagrams) - 1, -1, -1), frame.datagrams, strict=True):
        command, mark, address, offset, data, counter, flags, event = datagram
        length = len(data) | flags | (_MORE_FOLLOW if remaining else 0)
        parts += _DATAGRAM.pack(command, mark, address, offset, length, event), data, _COUNTER.pack(counter & 0xFFFF)
    body = b"".join(parts)
    ethernet = _ETHERNET.pack(frame.destination, frame.source, ETHERTYPE)
    header = received[_ETHERNET.size : _BEGIN] or _ETHERCAT.pack(len(body) | _DATAGRAMS)
    return (ethernet + header + body + received[_BEGIN + len(body) :]).ljust(SHORTEST_FRAME, b"\0")
