"""A ring buffer in shared memory: rows of numbers from a real-time process to another one, without waiting."""

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

SHARED_FOLDER = Path("/dev/shm")  # Folder that shows shared memory, on Linux

MARK = int.from_bytes(b"stepring", sys.byteorder)
HEAD = 8  # Offset of the count of rows pushed, in words of 64 bits; it has a separate cache line
ROWS_START = 128  # Offset of the first row [bytes]


class TickRing:
    """Ring buffer of rows of float64 with one writer and one reader, neither of which waits for the other.

    A row is written into a slot that the reader does not read, and only then the count of rows pushed, one aligned
    64-bit word, is increased. So a row is either complete or absent, also if the writer is killed while it writes. The
    reader reads the count again after copying, and drops the rows that the writer may have overwritten meanwhile. A
    reader that dies leaves no trace; another one may attach.

    This requires that stores become visible, and loads happen, in the order of the program. x86-64 guarantees that. ARM
    does not: there, the count could become visible some nanoseconds before the numbers of its row, though never to a
    reader that starts after the writer has died.

    It is created by `create`, and opened by `attach` in the other process. Leaving its context closes it, and frees the
    memory in the process that created it.

    Attributes:
        name: Name by which the other process attaches.
        fields: Number of fields in a row.
        rows: Number of rows that are kept for the reader.
        lost: Number of rows that this reader did not get: overwritten before or while it read them.
    """

    def __init__(self, memory: SharedMemory, fields: int, rows: int, *, created: bool):
        self.name = memory.name
        self.fields = fields
        self.rows = rows
        self.lost = 0
        self._memory = memory
        self._created = created
        self._bytes = _bytes(memory)
        self._words = self._bytes[:ROWS_START].cast("Q")
        self._slots = np.frombuffer(self._bytes, float, (rows + 1) * fields, ROWS_START).reshape(rows + 1, fields)
        self._row = struct.Struct(f"{fields}d")
        self._pushed = self._words[HEAD]
        self._read = 0

    @classmethod
    def create(cls, fields: int, rows: int) -> Self:
        """Creates an empty ring, which exists until `unlink`.

        Args:
            fields: Number of fields in a row.
            rows: Number of rows that the reader may be behind without a loss.

        Raises:
            OSError: There is not enough memory.
        """
        if fields < 1 or rows < 1:
            raise ValueError(f"a ring of {rows} rows of {fields} numbers; both must be 1 or more")
        memory = created_memory(_size(fields, rows))
        struct.pack_into("3Q", _bytes(memory), 0, MARK, fields, rows)
        return cls(memory, fields, rows, created=True)

    @classmethod
    def attach(cls, name: str) -> Self:
        """Opens the ring that another process created; rows that are no longer in it count as lost.

        Raises:
            FileNotFoundError: There is no memory of that name.
            ValueError: The memory is not a ring.
        """
        memory = attached_memory(name)
        mark, fields, rows = struct.unpack_from("3Q", _bytes(memory)) if memory.size >= ROWS_START else (0, 0, 0)
        if mark != MARK or not fields or not rows or _size(fields, rows) > memory.size:
            memory.close()
            raise ValueError(f"shared memory {name!r} is not a tick ring; give the `name` of one that was created")
        return cls(memory, fields, rows, created=False)

    def push(self, row: Sequence[float]) -> None:
        """Writes a row and publishes it.

        Args:
            row: Its `fields` numbers.

        Raises:
            struct.error: It has another length, or an entry is not a number; the ring is unchanged.
        """
        pushed = self._pushed
        self._row.pack_into(self._bytes, ROWS_START + pushed % (self.rows + 1) * self._row.size, *row)
        self._pushed = pushed + 1
        # This is one store; struct's "<Q" would store byte by byte.
        self._words[HEAD] = self._pushed

    def drain(self) -> Array:
        """Returns all complete rows since the last call, in order; shape (k, fields)."""
        slots = self.rows + 1
        pushed = self._words[HEAD]
        first = max(self._read, pushed - self.rows)
        copied = self._slots[np.arange(first, pushed) % slots]
        # By now the writer may be writing the row after the published ones, into the slot of a copied row.
        intact = min(pushed, max(first, self._words[HEAD] - self.rows))
        self.lost += intact - self._read
        self._read = pushed
        return copied[intact - first :]

    def close(self) -> None:
        """Closes the memory in this process; afterwards nothing can be pushed or drained."""
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
    """Size of a ring [bytes]; the row being written has a slot in addition to the rows that are kept."""
    return ROWS_START + 8 * fields * (rows + 1)


def _bytes(memory: SharedMemory) -> memoryview:
    assert memory.buf is not None, "closed"
    return memory.buf


def created_memory(size: int) -> SharedMemory:
    """Creates shared memory of a size [bytes] with all pages allocated: else writing could fail on a full /dev/shm.

    Raises:
        OSError: There is not enough memory.
    """
    memory = SharedMemory(create=True, size=size)
    file = SHARED_FOLDER / memory.name
    try:
        if file.exists():
            with file.open("r+b") as backing:
                os.posix_fallocate(backing.fileno(), 0, size)
    except OSError:
        memory.close()
        memory.unlink()
        raise
    return memory


def free_memory(name: str) -> None:
    """Frees shared memory whose creator was killed; its resource tracker does so too, unless it was killed as well."""
    (SHARED_FOLDER / name).unlink(missing_ok=True)


def attached_memory(name: str) -> SharedMemory:
    """Opens shared memory that this process does not free when it ends; its creator does."""
    if sys.version_info >= (3, 13):
        return SharedMemory(name, track=False)
    register = resource_tracker.register
    resource_tracker.register = lambda *_: None
    try:
        return SharedMemory(name)
    finally:
        resource_tracker.register = register
