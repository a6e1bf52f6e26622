"""Frames to controllers and their replies; each exchange has a timeout.

The moteus library encodes the frames and decodes the replies; python-can transports them. The library's own transport
needs asyncio and took 1.7 times as long for the same frames on the virtual bus, so it is not used.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from struct import error as StructError
from time import monotonic
from typing import TypeVar

import can
import moteus

from stepgap.rigs.rig import RigFault

REPLY_REQUIRED = 0x8000  # Bit of a CAN identifier that requests a reply of the controller
MOST_LATE = 64  # Largest number of late frames of earlier exchanges that are discarded before a new one
_LONGEST_FRAME = 64  # Largest number of bytes in a CAN-FD frame
PADDING = b"\x50"  # Subframe without content
Registers = Mapping[int, float]  # Values of a controller by register
_Answer = TypeVar("_Answer")  # What a frame of a controller contains


def _subframes(data: bytes) -> Iterator[moteus.Subframe]:
    """The first subframes of a frame; each takes a byte at least, but a frame may claim any number of them."""
    return islice(moteus.parse_frame(data), _LONGEST_FRAME)


def registers_of(data: bytes) -> Registers | None:
    """Decodes the registers of a frame; None if it is not a reply."""
    registers = {}
    try:
        for part in _subframes(data):
            if isinstance(part, moteus.RegisterSubframe):
                if part.type != moteus.SubframeType.RESPONSE:
                    return None
                registers[part.register] = moteus.scale_register(part.register, part.resolution, part.value)
    except (StructError, RuntimeError, ValueError):
        return None
    return registers or None


def stream_of(data: bytes) -> bytes | None:
    """Text of the diagnostic channel in a frame, empty if there is none now; None if it is not a reply."""
    text = None
    try:
        for part in _subframes(data):
            if isinstance(part, moteus.StreamSubframe) and part.type == moteus.SubframeType.STREAM_SERVER_TO_CLIENT:
                text = (text or b"") + bytes(part.data)
    except (StructError, RuntimeError, ValueError):
        return None
    return text


class CanBus:
    """A CAN-FD bus, by an interface of python-can and its channel, with moteus controllers on it.

    Raises:
        RigFault: It cannot be opened.
    """

    def __init__(self, interface: str, channel: str):
        self._name = f"{interface} {channel}"
        try:
            self._bus = can.Bus(interface=interface, channel=channel, fd=True)
        except (can.CanError, OSError, ValueError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise RigFault(f"the CAN bus {self._name} cannot be opened: {reason}") from None

    @property
    def name(self) -> str:
        """Interface and channel, for messages."""
        return self._name

    def send(self, commands: Mapping[int, moteus.Command]) -> None:
        """Sends a command to each controller; late replies to earlier commands are discarded.

        Raises:
            RigFault: The interface does not accept frames.
        """
        try:
            self._discard_late_frames()
            for number, command in commands.items():
                self._bus.send(_message(number, command))
        except (can.CanError, OSError) as error:
            raise RigFault(f"the CAN bus {self._name} does not accept frames: {error}") from None

    def receive(
        self, wanted: Collection[int], timeout: float, decode: Callable[[bytes], _Answer | None]
    ) -> dict[int, _Answer]:
        """Receives the replies of the controllers `wanted` that arrive within `timeout` [s], decoded."""
        missing = set(wanted)
        replies = {}
        until = monotonic() + timeout
        while missing:
            remaining = until - monotonic()
            frame = self._receive(max(remaining, 0.0))
            if frame:
                sender = frame.arbitration_id >> 8
                addressed = frame.arbitration_id & 0xFF
                answer = decode(bytes(frame.data)) if addressed == 0 and sender in missing else None
                if answer is not None:
                    missing.discard(sender)
                    replies[sender] = answer
            if remaining <= 0:
                break
        return replies

    def close(self) -> None:
        """Releases the bus."""
        self._bus.shutdown()

    def _discard_late_frames(self) -> None:
        for _ in range(MOST_LATE):
            if not self._bus.recv(0.0):
                return

    def _receive(self, timeout: float) -> can.Message | None:
        with suppress(can.CanError, OSError):  # counts as no reply
            return self._bus.recv(timeout)
        return None


def _message(number: int, command: moteus.Command) -> can.Message:
    identifier = number | (REPLY_REQUIRED if command.reply_required else 0)
    data = bytes(command.data)
    return can.Message(
        arbitration_id=identifier,
        is_extended_id=identifier > 0x7FF,
        is_fd=True,
        bitrate_switch=True,
        data=data.ljust(can.util.dlc2len(can.util.len2dlc(len(data))), PADDING),
    )
