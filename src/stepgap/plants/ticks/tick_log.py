"""The log of every tick: MCAP files that Foxglove and PlotJuggler open, and recovery from damaged files.

One channel, `ticks`, has one message per tick. Metadata records contain the description of the log and its events, such
as the reason of a stop. Chunks are not compressed: all complete ticks of a truncated chunk can
be read. A tick of n numbers takes 47 + 9 n bytes, one more for each number after the fifteenth: with 20 numbers at
1 kHz an hour is 0.84 GB.

When files are read, they are untrusted and may be damaged. The reader of the `mcap` library trusts the lengths in a
file and ends at the first damaged record, so records are parsed here.
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
from mcap.records import Channel, Metadata, Schema
from mcap.well_known import MessageEncoding, SchemaEncoding
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

from stepgap.base.errors import StepGapError
from stepgap.base.files import removed_on_failure
from stepgap.plants.ticks.log_description import DESCRIPTION, EVENT, LogDescription, LogEvent
from stepgap.plants.ticks.tick_message import CHANNEL, HEAD_SIZE, SCHEMA_NAME, TickLayout
from stepgap.step import Array

TOPIC = "ticks"
CHUNK = 64 * 2**10  # Size at which a chunk is written to the file [bytes]
LARGEST_RECORD = 2**20  # Largest record that is read [bytes]

_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQIIQ")


class TickLogError(StepGapError):
    """A tick log cannot be written or read; the message is one line that names the file and the reason."""


class TickLog:
    """A new tick log, open for appending.

    Appended ticks are in the file as soon as a chunk is full, and on the disk after `flush`, which should be called
    about once per second; `close` adds the index that viewers need. If the process dies, or the disk is full,
    `recover_ticks` recovers all ticks that are in the file.

    Args:
        path: The file, which must not exist; its folder is created.
        units: Unit of each field by its name, in the order of a row; the first is time [s]. Names consist of letters,
            digits and underscores, units have no comma.
        description: When and with what it is recorded.

    Raises:
        TickLogError: The file exists or cannot be written.
        ValueError: A name or a unit is not valid.
    """

    def __init__(self, path: Path, units: Mapping[str, str], description: LogDescription | None = None):
        self._path = path
        self._layout = TickLayout(dict(units))
        self._ticks = 0
        with _reporting(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("xb")
        self._writer = Writer(self._file, CHUNK, CompressionType.NONE)
        with self._writing():
            self._writer.start()
            schema = self._writer.register_schema(SCHEMA_NAME, SchemaEncoding.Protobuf, self._layout.schema)
            self._writer.register_channel(TOPIC, MessageEncoding.Protobuf, schema, self._layout.metadata)
            if description:
                self._writer.add_metadata(DESCRIPTION, description.to_metadata())
            self._file.flush()

    def append(self, rows: Array) -> None:
        """Adds ticks.

        Args:
            rows: One tick per row, the first column its time [s]; shape (k, fields).

        Raises:
            TickLogError: The file cannot be written, for example on a full disk: its content remains, and the log is
                closed.
            ValueError: The shape is another one, or a time is not within 0…9e9 s.
        """
        messages = self._layout.messages(rows, self._ticks)
        content = messages.tobytes()
        size = messages.itemsize
        times = messages["log_time"].tolist()
        numbers = messages["sequence"].tolist()
        with self._writing():
            for i, (time, number) in enumerate(zip(times, numbers, strict=True)):
                self._writer.add_message(CHANNEL, time, content[i * size + HEAD_SIZE : (i + 1) * size], time, number)
            self._file.flush()
        self._ticks += len(messages)

    def note(self, event: LogEvent) -> None:
        """Adds an event.

        Raises:
            TickLogError: As for `append`.
        """
        with self._writing():
            self._writer.add_metadata(EVENT, event.to_metadata())
            self._file.flush()

    def flush(self) -> None:
        """Ends the chunk and waits until all appended ticks are on the disk.

        Raises:
            TickLogError: As for `append`.
        """
        with self._writing():
            self._writer.flush()
            os.fsync(self._file.fileno())

    def close(self) -> None:
        """Ends the file with its index and closes it; does nothing if it is closed.

        Raises:
            TickLogError: As for `append`.
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
        """Closes the file when it cannot be written."""
        if self._file.closed:
            raise TickLogError(f"{self._path}: this log is closed; open another")
        try:
            with _reporting(self._path):
                yield
        except TickLogError:
            with suppress(OSError):  # closing tries again to write the buffered data
                self._file.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()


def next_path(folder: Path) -> Path:
    """Path of the next log in a folder: `ticks-0.mcap`, `ticks-1.mcap`, …, after the last existing one."""
    names = [re.fullmatch(r"ticks-([0-9]{1,9})\.mcap", path.name) for path in folder.glob("ticks-*.mcap")]
    last = max((int(name[1]) for name in names if name), default=-1)
    return folder / f"ticks-{last + 1}.mcap"


def read_ticks(path: Path) -> tuple[dict[str, str], Array]:
    """Reads a log: returns the units of the fields by their names, and the ticks (k, fields).

    Raises:
        TickLogError: The file is not a tick log, or it is damaged.
    """
    units, rows, faults = read_intact_ticks(path)
    if faults:
        raise TickLogError(f"{path}: {faults[0]}; `recover_ticks` recovers the intact part")
    return units, rows


def read_intact_ticks(path: Path) -> tuple[dict[str, str], Array, tuple[str, ...]]:
    """Reads the intact part of a log, as of a process that was killed: units, ticks (k, fields), and its faults.

    Raises:
        TickLogError: The file is not a tick log.
    """
    faults: list[str] = []
    with _opened(path) as file:
        layout = _layout(file, path)
        blocks = [layout.rows(messages) for messages in _messages(file, layout, faults)]
    return dict(layout.units), np.concatenate([np.empty((0, len(layout.units))), *blocks]), tuple(faults)


def read_description(path: Path) -> tuple[LogDescription, list[LogEvent]]:
    """Reads the description and the events of a log, as far as the file is intact; an older log has none.

    Raises:
        TickLogError: The file is not an MCAP file.
    """
    with _opened(path) as file:
        return _described(file)


class Recovered(NamedTuple):
    """Result of the recovery of a log.

    Attributes:
        ticks: Number of recovered ticks.
        faults: Faults of the log, one line each; empty for an intact log.
    """

    ticks: int
    faults: tuple[str, ...]


def recover_ticks(path: Path, out: Path) -> Recovered:
    """Recovers the ticks of a damaged log: writes those of every intact chunk, and of a truncated one, to a new log.

    A chunk with a wrong checksum is omitted; all that follows a record with a wrong length is lost.

    Args:
        path: The log; it is not changed.
        out: The new log, which must not exist.

    Raises:
        TickLogError: Nothing can be recovered, or `out` exists or cannot be written.
    """
    faults: list[str] = []
    ticks = 0
    with _opened(path) as file:
        layout = _layout(file, path)
        description, events = _described(file)
        log = TickLog(out, layout.units, description)
        with removed_on_failure(out), log:
            for messages in _messages(file, layout, faults):
                log.append(layout.rows(messages))
                ticks += len(messages)
            for event in events:
                log.note(event)
    return Recovered(ticks, tuple(faults))


@contextmanager
def _reporting(path: Path) -> Iterator[None]:
    """Turns an OSError into a TickLogError that names the file."""
    try:
        yield
    except OSError as error:
        raise TickLogError(f"{path}: {error.strerror}") from error


@contextmanager
def _opened(path: Path) -> Iterator[BinaryIO]:
    """Opens an MCAP file for reading."""
    with _reporting(path):
        if path.exists() and not path.is_file():  # opening a pipe would wait
            raise TickLogError(f"{path}: this is not a file; give a tick log")
        with path.open("rb") as file:
            if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                raise TickLogError(f"{path}: this is not an MCAP file; give a tick log")
            yield file


class _Part(NamedTuple):
    """A schema, a channel, metadata, or the content of a chunk.

    Attributes:
        offset: Start of its record [bytes].
        opcode: Opcode of its record.
        content: Its content, as far as it is in the file.
        complete: Whether it is not truncated.
        intact: Whether it is complete and its checksum is right.
    """

    offset: int
    opcode: int
    content: bytes
    complete: bool
    intact: bool


def _parts(file: BinaryIO, faults: list[str]) -> Iterator[_Part]:
    """Parses the records of a file up to its end, or up to a damaged one, which is added to the faults."""
    size = os.fstat(file.fileno()).st_size
    offset = len(MCAP0_MAGIC)
    while True:
        file.seek(offset)
        head = file.read(_HEAD.size)
        if len(head) < _HEAD.size:
            faults.append(f"it is truncated after {size} bytes, before its index is complete")
            return
        opcode, length = _HEAD.unpack(head)
        end = offset + _HEAD.size + length
        if opcode == Opcode.FOOTER and end + len(MCAP0_MAGIC) == size:
            return
        complete = opcode != 0 and end <= size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.CHUNK):
            body = file.read(min(length, LARGEST_RECORD))
            content, intact = _chunk(body) if opcode == Opcode.CHUNK else (body, True)
            yield _Part(offset=offset, opcode=opcode, content=content, complete=complete, intact=complete and intact)
        if not complete:
            faults.append(f"it is truncated or damaged in the record at byte {offset} of {size}")
            return
        offset = end


def _chunk(body: bytes) -> tuple[bytes, bool]:
    """Content of a chunk, as far as it is there, and whether its length and checksum are right."""
    if len(body) < _CHUNK_HEAD.size:
        return b"", False
    _, _, size, checksum, compression, stored = _CHUNK_HEAD.unpack_from(body)
    content = body[_CHUNK_HEAD.size :]
    if compression:
        return b"", False
    return content, len(content) == size == stored and zlib.crc32(content) == checksum


def _split(content: bytes) -> tuple[list[tuple[int, bytes]], bytes]:
    """Splits a chunk into the schemas and channels at its start, with their opcodes, and the rest."""
    definitions = []
    start = 0
    while len(content) >= start + _HEAD.size:
        opcode, length = _HEAD.unpack_from(content, start)
        if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
            break
        definitions.append((opcode, content[start + _HEAD.size : start + _HEAD.size + length]))
        start += _HEAD.size + length
    return definitions, content[start:]


def _definitions(file: BinaryIO) -> Iterator[tuple[int, bytes, bool]]:
    """Yields all schemas and channels of a file: opcode, content, and whether it is intact."""
    for part in _parts(file, []):
        if part.opcode == Opcode.METADATA:
            continue
        chunk = part.opcode == Opcode.CHUNK
        for opcode, body in _split(part.content)[0] if chunk else [(part.opcode, part.content)]:
            yield opcode, body, part.intact


def _described(file: BinaryIO) -> tuple[LogDescription, list[LogEvent]]:
    """Description and events in the metadata records of a file; damaged ones are left out."""
    description = LogDescription()
    events = list[LogEvent]()
    for part in _parts(file, []):
        if part.opcode != Opcode.METADATA or not part.intact:
            continue
        with suppress(McapError, struct.error, ValueError):
            record = Metadata.read(ReadDataStream(BytesIO(part.content)))
            if record.name == EVENT:
                events.append(LogEvent.of_metadata(record.metadata))
            elif record.name == DESCRIPTION:
                description = LogDescription.of_metadata(record.metadata)
    return description, events


def _layout(file: BinaryIO, path: Path) -> TickLayout:
    """Reads the layout of the ticks, which a file contains in its first chunk and again in its index."""
    doubtful = None
    schema = b""
    for opcode, body, intact in _definitions(file):
        with suppress(McapError, struct.error, ValueError):
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(ReadDataStream(BytesIO(body))).data
                continue
            layout = TickLayout.of_channel(Channel.read(ReadDataStream(BytesIO(body))).metadata)
            if layout.schema == schema and intact:
                return layout
            doubtful = layout if layout.schema == schema else doubtful
    if doubtful is None:
        raise TickLogError(f"{path}: it has no description of ticks; it is not a tick log, or its start is missing")
    return doubtful


def _messages(file: BinaryIO, layout: TickLayout, faults: list[str]) -> Iterator[np.ndarray]:
    """Yields the messages of each chunk, up to the first truncated one; faults are added to the list."""
    expected = 0
    for part in _parts(file, faults):
        if part.opcode != Opcode.CHUNK:
            continue
        if part.complete and not part.intact:
            faults.append(f"the chunk at byte {part.offset} is omitted: it is damaged, compressed or too large")
            continue
        content = _split(part.content)[1]
        messages = layout.parse(content)
        if part.complete and messages.nbytes < len(content):
            faults.append(f"the chunk at byte {part.offset} contains other data than ticks")
        if not len(messages):
            continue
        first = int(messages["sequence"][0])
        if first != expected:
            faults.append(f"ticks are missing before the chunk at byte {part.offset}")
        expected = (first + len(messages)) % 2**32
        yield messages
