"""The log of every tick: MCAP files that Foxglove and PlotJuggler open, and what is left of broken ones.

One channel, `ticks`, has one message per tick. Chunks are not compressed: of one that the file breaks off in, every
whole tick is still there. A tick of n numbers takes 47 + 9 n bytes, one more for each number after the fifteenth: with
20 numbers at 1 kHz an hour is 0.84 GB.

Files are untrusted, and may be broken, when they are read; the reader of the `mcap` library believes the lengths it
finds and ends at the first broken record, so records are walked through here.
"""

import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import BinaryIO, NamedTuple, Self

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from stepgap.base.errors import StepGapError
from stepgap.plants.ticks.tick_message import CHANNEL, HEAD_SIZE, SCHEMA_NAME, TickLayout
from stepgap.step import Array

TOPIC = "ticks"
CHUNK = 64 * 2**10
"""Size at which a chunk is written to the file [bytes]."""
LARGEST_RECORD = 2**20
"""Largest record that is read [bytes]."""

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQIIQ")


class TickLogError(StepGapError):
    """A tick log cannot be written or read; the message is one line that names the file and what is wrong with it."""


class TickLog:
    """A new tick log, open for appending.

    What was appended is in the file as soon as a chunk is full, and on the disk after `flush`, which is to be called
    about once a second; `close` adds the index that viewers want. When the process dies, or the disk is full,
    `recover_ticks` has all that came into the file.

    Args:
        path: The file, which must not exist; its folder is made.
        units: Unit of each field by its name, in the order of a row; the first is time [s]. Names are of letters,
            digits and underscores, units have no comma.

    Raises:
        TickLogError: The file exists or cannot be written.
        ValueError: A name or a unit is none.
    """

    def __init__(self, path: Path, units: Mapping[str, str]):
        self._path, self._layout, self._ticks = path, TickLayout(dict(units)), 0
        with _reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        self._writer = Writer(self._file, CHUNK, CompressionType.NONE)
        with self._writing():
            self._writer.start()
            schema = self._writer.register_schema(SCHEMA_NAME, SchemaEncoding.Protobuf, self._layout.schema)
            self._writer.register_channel(TOPIC, MessageEncoding.Protobuf, schema, self._layout.metadata)
            self._file.flush()

    def append(self, rows: Array) -> None:
        """Adds ticks.

        Args:
            rows: A tick a row, the first column its time [s]; shape (k, fields).

        Raises:
            TickLogError: The disk is full, or the like: what is in the file stays, and the log is closed.
            ValueError: Not that shape, or a time that is not within 0…9e9 s.
        """
        messages = self._layout.messages(rows, self._ticks)
        content, size = messages.tobytes(), messages.itemsize
        times, numbers = messages["log_time"].tolist(), messages["sequence"].tolist()
        with self._writing():
            for i, (time, number) in enumerate(zip(times, numbers, strict=True)):
                self._writer.add_message(CHANNEL, time, content[i * size + HEAD_SIZE : (i + 1) * size], time, number)
            self._file.flush()
        self._ticks += len(messages)

    def flush(self) -> None:
        """Ends the chunk and waits until the disk has all that was appended.

        Raises:
            TickLogError: As of `append`.
        """
        with self._writing():
            self._writer.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Ends the file with its index and closes it, unless that was done.

        Raises:
            TickLogError: As of `append`.
        """
        if self._file.closed:
            return
        with self._writing():
            self._writer.finish()
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()

    @contextmanager
    def _writing(self) -> Iterator[None]:
        """Gives the file up when it cannot be written."""
        if self._file.closed:
            raise TickLogError(f"{self._path}: this log is closed; open another")
        try:
            with _reporting(self._path):
                yield
        except TickLogError:
            with suppress(OSError):  # closing tries once more to write what is buffered
                self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def next_path(folder: Path) -> Path:
    """Where the next log of a folder belongs: `ticks-0.mcap`, `ticks-1.mcap`, …, after the last that is there."""
    found = [re.fullmatch(r"ticks-([0-9]{1,9})\.mcap", path.name) for path in folder.glob("ticks-*.mcap")]
    return folder / f"ticks-{1 + max((int(number[1]) for number in found if number), default=-1)}.mcap"


def read_ticks(path: Path) -> tuple[dict[str, str], Array]:
    """The units of the fields by their names, and the ticks; shape (k, fields).

    Raises:
        TickLogError: It is no tick log, or not a whole one.
    """
    faults: list[str] = []
    with _opened(path) as file:
        layout = _layout(file, path)
        blocks = [layout.rows(messages) for messages in _messages(file, layout, faults)]
    if faults:
        raise TickLogError(f"{path}: {faults[0]}; `recover_ticks` saves what is whole")
    return dict(layout.units), np.concatenate([np.empty((0, len(layout.units))), *blocks])


class Recovered(NamedTuple):
    """What was saved of a log.

    Attributes:
        ticks: How many ticks.
        faults: What is wrong with the log, a line each; nothing with a whole one.
    """

    ticks: int
    faults: tuple[str, ...]


def recover_ticks(path: Path, out: Path) -> Recovered:
    """Saves the ticks of a broken log in a new one: of every whole chunk, and of the one that the file breaks off in.

    A chunk whose checksum is wrong is left out; all that follows a record whose length is wrong is lost.

    Args:
        path: The log; it is not changed.
        out: The new one, which must not exist.

    Raises:
        TickLogError: Nothing can be saved, or `out` exists or cannot be written.
    """
    faults: list[str] = []
    ticks = 0
    with _opened(path) as file:
        layout = _layout(file, path)
        with TickLog(out, layout.units) as log:
            for messages in _messages(file, layout, faults):
                log.append(layout.rows(messages))
                ticks += len(messages)
    return Recovered(ticks, tuple(faults))


@contextmanager
def _reporting(path: Path) -> Iterator[None]:
    """Says what the file system says, of which file."""
    try:
        yield
    except OSError as error:
        raise TickLogError(f"{path}: {error.strerror}") from error


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """An MCAP file for reading."""
    with _reporting(path):
        if path.exists() and not path.is_file():  # opening a pipe would wait
            raise TickLogError(f"{path}: this is no file; give a tick log")
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise TickLogError(f"{path}: this is no MCAP file; give a tick log")
            yield file


class _Part(NamedTuple):
    """A schema, a channel, or what a chunk holds.

    Attributes:
        offset: Where its record begins [bytes].
        opcode: Which of them.
        content: What it holds, as far as the file has it.
        whole: The file does not break off in it.
        sound: It is as it was written.
    """

    offset: int
    opcode: int
    content: bytes
    whole: bool
    sound: bool


def _parts(file: BinaryIO, faults: list[str]) -> Iterator[_Part]:
    """Goes through the records of a file up to its end, or to where one is broken, which is added to the faults."""
    size = os.fstat(file.fileno()).st_size
    offset = len(MCAP0_MAGIC)
    while True:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            faults.append(f"it breaks off after {size} bytes, before its index is complete")
            return
        opcode, length = _HEAD.unpack(head)
        end = offset + _HEAD.size + length
        if opcode == Opcode.FOOTER and end + len(MCAP0_MAGIC) == size:
            return
        whole = opcode != 0 and end <= size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.CHUNK):
            body = file.read(min(length, LARGEST_RECORD))
            content, sound = _chunk(body) if opcode == Opcode.CHUNK else (body, True)
            yield _Part(offset, opcode, content, whole, whole and sound)
        if not whole:
            faults.append(f"it breaks off, or is damaged, in the record at byte {offset} of {size}")
            return
        offset = end


def _chunk(body: bytes) -> tuple[bytes, bool]:
    """What a chunk holds, as far as it is there, and whether it is as it was written."""
    if len(body) < _CHUNK_HEAD.size:
        return b"", False
    _, _, size, checksum, compression, stored = _CHUNK_HEAD.unpack_from(body)
    content = body[_CHUNK_HEAD.size :]
    if compression:
        return b"", False
    return content, len(content) == size == stored and zlib.crc32(content) == checksum


def _split(content: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """The schemas and channels, by opcode, that a chunk begins with, and the rest of it."""
    definitions, start = [], 0
    while len(content) >= start + _HEAD.size:
        opcode, length = _HEAD.unpack_from(content, start)
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            break
        definitions.append((opcode, content[start + _HEAD.size : start + _HEAD.size + length]))
        start += _HEAD.size + length
    return definitions, content[start:]


def _definitions(file: BinaryIO) -> Iterator[tuple[int, bytes, bool]]:
    """All schemas and channels of a file: opcode, content, and whether it is as it was written."""
    for part in _parts(file, []):
        chunk = part.opcode == Opcode.CHUNK
        for opcode, body in _split(part.content)[0] if chunk else [(part.opcode, part.content)]:
            yield opcode, body, part.sound


def _layout(file: BinaryIO, path: Path) -> TickLayout:
    """What a file says of its ticks, in its first chunk and again in its index."""
    doubtful, schema = None, b""
    for opcode, body, sound in _definitions(file):
        with suppress(McapError, struct.error, ValueError):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(body))).data
                continue
            layout = TickLayout.of_channel(Channel.read(ReadDataStream(BytesIO(body))).metadata)
            if layout.schema == schema and sound:
                return layout
            doubtful = layout if layout.schema == schema else doubtful
    if doubtful is None:
        raise TickLogError(f"{path}: nothing in it says what its ticks are; it is no tick log, or too little is left")
    return doubtful


def _messages(file: BinaryIO, layout: TickLayout, faults: list[str]) -> Iterator[np.ndarray]:
    """The messages of each chunk, up to the first that is not whole; what is wrong is added to the faults."""
    expected = 0
    for part in _parts(file, faults):
        if part.opcode != Opcode.CHUNK:
            continue
        if part.whole and not part.sound:
            faults.append(f"the chunk at byte {part.offset} is left out: it is damaged, compressed or too large")
            continue
        content = _split(part.content)[1]
        messages = layout.parse(content)
        if part.whole and messages.nbytes < len(content):
            faults.append(f"the chunk at byte {part.offset} holds other than ticks")
        if not len(messages):
            continue
        first = int(messages["sequence"][0])
        if first != expected:
            faults.append(f"ticks are missing before the chunk at byte {part.offset}")
        expected = (first + len(messages)) % 2**32
        yield messages
