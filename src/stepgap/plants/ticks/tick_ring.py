"""Rows of numbers from a real-time process to another one, through shared memory, without waiting."""

import os
import struct
import sys
from collections.abc import Sequence
from multiprocessing import resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path
from typing import Self

import numpy as np

from stepgap.step import Array

MARK = int.from_bytes(b"stepring", sys.byteorder)
HEAD = 8
"""Place of the count of rows pushed, in words of 64 bits; it has a cache line of its own."""
ROWS_START = 128
"""Place of the first row [bytes]."""


class TickRing:
    """Ring of rows of float64 with one writer and one reader, neither of which ever waits for the other.

    A row is written into a slot that the reader does not look at, and only then is the count of rows pushed, one
    aligned 64-bit word, moved on. So a row is either whole or not there, also when the writer is killed in the middle
    of one. What the reader copied while the writer may have come round is found by reading the count again, and
    dropped. A reader that dies leaves nothing behind; another one may attach.

    This needs stores to become visible, and loads to happen, in the order of the program. x86-64 guarantees that. ARM
    does not: there, the count could be seen some nanoseconds before the numbers of its row, though never by a reader
    that starts after the writer has died.

    Made by `create`, or by `attach` in the other process. Leaving its context closes it, and frees the memory where it
    was created.

    Attributes:
        name: By which the other process attaches.
        fields: Numbers in a row.
        rows: Rows that are kept for the reader.
        lost: Rows that this reader never got: overwritten before it read them, or while it did.
    """

    def __init__(self, memory: SharedMemory, fields: int, rows: int, *, created: bool):
        self.name, self.fields, self.rows, self.lost = memory.name, fields, rows, 0
        self._memory, self._created, self._bytes = memory, created, _bytes(memory)
        self._words = self._bytes[:ROWS_START].cast("Q")
        self._slots = np.frombuffer(self._bytes, float, (rows + 1) * fields, ROWS_START).reshape(rows + 1, fields)
        self._row = struct.Struct(f"{fields}d")
        self._pushed = self._words[HEAD]
        self._read = 0

    @classmethod
    def create(cls, fields: int, rows: int) -> Self:
        """A new ring, empty; its creator has it until `unlink`.

        Args:
            fields: Numbers in a row.
            rows: Rows that the reader may be behind without losing one.

        Raises:
            OSError: There is not so much memory.
        """
        if fields < 1 or rows < 1:
            raise ValueError(f"a ring of {rows} rows of {fields} numbers; both must be 1 or more")
        memory = created_memory(_size(fields, rows))
        struct.pack_into("3Q", _bytes(memory), 0, MARK, fields, rows)
        return cls(memory, fields, rows, created=True)

    @classmethod
    def attach(cls, name: str) -> Self:
        """The ring that another process created; a reader gets what is still in it, and counts the rest as lost.

        Raises:
            FileNotFoundError: There is no memory of that name.
            ValueError: It is no ring.
        """
        memory = attached_memory(name)
        mark, fields, rows = struct.unpack_from("3Q", _bytes(memory)) if memory.size >= ROWS_START else (0, 0, 0)
        if mark != MARK or not fields or not rows or _size(fields, rows) > memory.size:
            memory.close()
            raise ValueError(f"shared memory {name!r} is no tick ring; give the `name` of one that was created")
        return cls(memory, fields, rows, created=False)

    def push(self, row: Sequence[float]) -> None:
        """Writes a row and publishes it.

        Args:
            row: Numbers, `fields` of them.

        Raises:
            struct.error: It has another length, or something in it is no number; the ring is as before.
        """
        pushed = self._pushed
        self._row.pack_into(self._bytes, ROWS_START + pushed % (self.rows + 1) * self._row.size, *row)
        self._pushed = pushed + 1
        # Not struct's "<Q", which stores byte by byte: this is one store.
        self._words[HEAD] = self._pushed

    def drain(self) -> Array:
        """All whole rows since the last call, in order; shape (k, fields)."""
        slots, pushed = self.rows + 1, self._words[HEAD]
        first = max(self._read, pushed - self.rows)
        copied = self._slots[np.arange(first, pushed) % slots]
        # By now the writer may be inside the row that follows those it has published, in the slot of one copied.
        whole = min(pushed, max(first, self._words[HEAD] - self.rows))
        self.lost += whole - self._read
        self._read = pushed
        return copied[whole - first :]

    def close(self) -> None:
        """Lets go of the memory in this process; nothing can be pushed or drained from then on."""
        self._words.release()
        self._slots = np.empty((0, self.fields))
        self._memory.close()

    def unlink(self) -> None:
        """Frees the memory as soon as both processes have closed it; for the process that created it."""
        self._memory.unlink()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
        if self._created:
            self.unlink()


def _size(fields: int, rows: int) -> int:
    """Bytes of a ring; the row being written has a slot beside the rows that are kept."""
    return ROWS_START + 8 * fields * (rows + 1)


def _bytes(memory: SharedMemory) -> memoryview:
    assert memory.buf is not None, "closed"
    return memory.buf


def created_memory(size: int) -> SharedMemory:
    """New shared memory, all of it there: or a full /dev/shm would end a process when it first writes to some page.

    Raises:
        OSError: There is not so much of it [bytes].
    """
    memory = SharedMemory(create=True, size=size)
    file = Path("/dev/shm", memory.name)  # where Linux has it
    try:
        if file.exists():
            with file.open("r+b") as backing:
                os.posix_fallocate(backing.fileno(), 0, size)
    except OSError:
        memory.close()
        memory.unlink()
        raise
    return memory


def attached_memory(name: str) -> SharedMemory:
    """Shared memory that this process will not free when it ends: that is its creator's to do."""
    if sys.version_info >= (3, 13):
        return SharedMemory(name, track=False)
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return SharedMemory(name)
    finally:
        resource_tracker.register = register
