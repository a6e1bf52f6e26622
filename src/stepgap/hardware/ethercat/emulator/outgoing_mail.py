"""The mailboxes in a slave's memory, and the messages that wait for the master (ETG.1000.4 §5.6)."""

from collections import deque
from collections.abc import Iterable
from struct import unpack_from

from stepgap.hardware.ethercat.emulator import registers as reg

_MANAGER = reg.SYNC_MANAGER + reg.SYNC_MANAGER_SIZE
"""Registers of sync manager 1, that of the outgoing mailbox."""


def mailbox_area(memory: bytearray, number: int) -> tuple[int, int, bool]:
    """Start, length and full flag of sync manager 0 or 1; length 0 if it is off or not in free memory."""
    base = reg.SYNC_MANAGER + number * reg.SYNC_MANAGER_SIZE
    start, length, _, status, active = unpack_from("<HHBBB", memory, base)
    on = active & reg.SYNC_MANAGER_ENABLED and reg.PROCESS_RAM <= start <= reg.MEMORY_SIZE - length
    return start, length if on else 0, bool(status & reg.MAILBOX_FULL)


class OutgoingMail:
    """Messages from a slave to the master, one after the other in the outgoing mailbox.

    Args:
        memory: Memory of the slave controller.
    """

    def __init__(self, memory: bytearray):
        self._memory, self._waiting = memory, deque[bytes]()
        self._sent, self._counter = b"", 0

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
