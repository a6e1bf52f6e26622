"""Messages by topic: MCAP files, and bags of ROS 1 and of ROS 2.

rosbags parses the definitions of messages, which are interpreted here. It would also compile Python code made from
them; a log should not lead to code that runs. The interpreter of mcap-ros2-support knows neither ROS 1 nor IDL, reads
negative durations as large ones, and does not say whether a message fits its definition.
"""

import json
import re
import sqlite3
import struct
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.bag_files import (
    METADATA,
    ZSTD_MAGIC,
    messages_in,
    metadata_in,
    missing_files,
    opened_database,
    other_parts,
    parts_of,
    release_in,
    unpacked,
)
from stepgap.logs.tables.files import LARGEST_FILE, LARGEST_PART, check_file_size, decompress_part, library, reading
from stepgap.logs.tables.log_table import MOST_ELEMENTS, LogTable
from stepgap.logs.tables.messages import Decoder, TopicRows, unreadable
from stepgap.records.steps_csv import RecordError

MCAP_MAGIC = b"\x89MCAP0\r\n"
ROS1_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\0"

_NUMBERS = {
    "bool": "?",
    "byte": "b",
    "char": "B",
    "octet": "B",
    **{f"int{bits}": code for bits, code in ((8, "b"), (16, "h"), (32, "i"), (64, "q"))},
    **{f"uint{bits}": code for bits, code in ((8, "B"), (16, "H"), (32, "I"), (64, "Q"))},
    "float32": "f",
    "float64": "d",
}
"""Codes of `struct` for the basic types."""

_LANGUAGES = (("cdr", "ros2msg"), ("cdr", "ros2idl"), ("ros1", "ros1msg"))
"""Encodings of messages, each with a language of their definitions."""

_RULE = re.compile(r"^=+[ \t]*$", re.MULTILINE)
"""Line between the definitions of a message and of the types in it."""

_IDL_HEADER = re.compile(r"^(=+|IDL: .*)$", re.MULTILINE)

_DEEPEST = 50


def read_mcap(
    paths: Sequence[Path], unread: dict[str, str], release: str = "", messages: int = 0
) -> dict[str, LogTable]:
    """One table for each topic, with `log_time` [s]; several files are parts of one log.

    Of a file that was cut off, the messages before its end are read, with a `StepGapWarning`.

    Args:
        unread: The topics that cannot be read are added to it, with the reasons.
        release: Release of ROS 2 that recorded the log, if it is known.
        messages: Number of messages in the log, if it is known.
    """
    topics = TopicRows(str(paths[0]))
    for path in paths:
        before = topics.count
        with reading(path, "MCAP"), unpacked(path) as whole, whole.open("rb") as file:
            from mcap.exceptions import EndOfFile

            try:
                for topic, time, data, decoders in _messages(file, path, release):
                    topics.append(topic, time, data, decoders)
            except EndOfFile:
                count = topics.count - before
                if not count:
                    raise ValueError("cut off before its first message") from None
                warnings.warn(f"{path}: cut off; the {count} messages before its end are read", StepGapWarning, 2)
    _check_count(paths[0].parent, topics.count, messages)
    return {topic: _by_time(table) for topic, table in topics.tables(unread).items()}


def _check_count(path: Path, count: int, expected: int) -> None:
    if count < expected:
        lost = f"{count} messages, but {METADATA} names {expected}; a part of the bag was lost, or is elsewhere"
        warnings.warn(f"{path}: {lost}", StepGapWarning, stacklevel=2)


def _messages(file: Any, path: Path, release: str) -> Iterator[tuple[str, int, bytes, Sequence[Decoder]]]:
    """Yields topic, time [ns], content and possible decoders of the messages."""
    from mcap.records import Channel, Message, Schema

    schemas: dict[int, Any] = {}
    channels: dict[int, tuple[str, Sequence[Decoder]]] = {}
    for record in _records(file):
        if isinstance(record, Schema):
            schemas[record.id] = record
        elif isinstance(record, Channel) and record.id not in channels:
            schema = schemas.get(record.schema_id)
            channels[record.id] = record.topic, _decoders(record.message_encoding, schema, path, release)
        elif isinstance(record, Message):
            topic, decoders = channels[record.channel_id]
            yield topic, record.log_time, record.data, decoders


def _records(file: Any) -> Iterator[Any]:
    from mcap.records import Chunk, DataEnd
    from mcap.stream_reader import StreamReader, breakup_chunk

    size = 0
    whole: Any = _WholeReads(file)
    for record in StreamReader(whole, emit_chunks=True, record_size_limit=LARGEST_PART).records:
        if isinstance(record, DataEnd):
            return
        if not isinstance(record, Chunk):
            yield record
            continue
        record.data = decompress_part(record.data, record.compression)
        record.compression = ""
        size += len(record.data)
        if size > LARGEST_FILE:
            raise ValueError(f"larger than {LARGEST_FILE} bytes when decompressed")
        yield from breakup_chunk(record, validate_crc=True)


class _WholeReads:
    """A file of which a read beyond its end is an error, so that no cut message counts as a short one."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def read(self, size: int) -> bytes:
        """Reads this number of bytes, or raises EndOfFile."""
        from mcap.exceptions import EndOfFile

        content = self._file.read(size)
        if len(content) < size:
            raise EndOfFile
        return content


def _decoders(encoding: str, schema: Any, path: Path, release: str) -> list[Decoder]:
    if encoding == "json":
        return [_json]
    form = schema.encoding if schema is not None else ""
    if encoding == form == "protobuf":
        return [_protobuf_decoder(schema, path)]
    if schema is not None and (encoding == "cdr" or (encoding, form) == ("ros1", "ros1msg")):
        return _ros_decoders(path, encoding, schema.name, schema.data.decode("utf-8", "replace"), form, release)
    return [unreadable(f"messages in {encoding!r:.60}, not read; JSON, protobuf and ROS messages are")]


def _protobuf_decoder(schema: Any, path: Path) -> Decoder:
    factory = library("mcap_protobuf.decoder", path).DecoderFactory()
    try:
        decode = factory.decoder_for("protobuf", schema)
    except Exception:
        return unreadable(f"the definition of {schema.name:.80} cannot be read")
    return lambda data: _protobuf_tree(decode(data))


def _json(data: bytes) -> Any:
    tree = json.loads(data, parse_constant=lambda _: None)
    if not isinstance(tree, dict):
        raise ValueError("a JSON message that is not an object")
    return tree


def _protobuf_tree(message: Any) -> Any:
    """A message as a tree; a field that knows that it is absent is left out, others have their default."""
    if not hasattr(message, "DESCRIPTOR"):
        return message
    tree: dict[str, Any] = {}
    for field in message.DESCRIPTOR.fields:
        if field.has_presence and not message.HasField(field.name):
            continue
        value = getattr(message, field.name)
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            tree[field.name] = {str(key): _protobuf_tree(value[key]) for key in value}
        elif isinstance(value, str | bytes | int | float) or hasattr(value, "DESCRIPTOR"):
            tree[field.name] = _protobuf_tree(value)
        else:
            tree[field.name] = [_protobuf_tree(part) for part in value]
    return tree


def is_ros2_folder(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag: it has its metadata, or at least its parts."""
    return path.is_dir() and ((path / METADATA).is_file() or any(parts_of(path)))


def read_ros2_folder(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a ROS 2 bag: a folder with metadata.yaml and parts in MCAP or SQLite.

    Topics that cannot be read are added to `unread`, with the reasons, and so are parts that are missing.
    """
    mcaps, databases = parts_of(path)
    if bool(mcaps) == bool(databases):
        raise RecordError(f"{path}: a ROS 2 bag must have .mcap or .db3 files, not both")
    metadata = metadata_in(path)
    unread.update(missing_files(path, metadata))
    messages = messages_in(metadata)
    if mcaps:
        return read_mcap(mcaps, unread, release_in(metadata), messages)
    return _read_databases(path, databases, unread, release_in(metadata), messages)


def read_part_in_mcap(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of an MCAP file, which may be a part of a ROS 2 bag; `unread` as of `read_ros2_folder`."""
    unread.update(other_parts(path))
    return read_mcap([path], unread, release_in(metadata_in(path.parent)))


def read_ros2_database(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a .db3 file, which is a part of a ROS 2 bag; `unread` as of `read_ros2_folder`."""
    unread.update(other_parts(path))
    return _read_databases(path, [path], unread, release_in(metadata_in(path.parent)))


def read_ros1_bag(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a ROS 1 bag; `unread` as of `read_ros2_folder`."""
    rosbag1 = library("rosbags.rosbag1", path)
    check_file_size(path)
    topics = TopicRows(str(path))
    decoders = dict[int, list[Decoder]]()
    size = 0
    with reading(path, "ROS 1 bag"), _opened_ros1_bag(rosbag1, path) as bag:
        bag.chunks = {at: chunk._replace(decompressor=_bounded(chunk)) for at, chunk in bag.chunks.items()}
        for connection, time, data in bag.messages():
            size += len(data)
            if size > LARGEST_FILE:
                raise ValueError(f"more than {LARGEST_FILE} bytes of messages")
            if connection.id not in decoders:
                definition = connection.msgtype, connection.msgdef.data
                decoders[connection.id] = _ros_decoders(path, "ros1", *definition, "ros1msg")
            topics.append(connection.topic, time, data, decoders[connection.id])
    return topics.tables(unread)


def _opened_ros1_bag(rosbag1: Any, path: Path) -> Any:
    bag = rosbag1.Reader(path)
    try:
        bag.open()
    except rosbag1.ReaderError as error:
        if "not indexed" not in str(error):
            raise
        cause = "a ROS 1 bag without an index, as of a recorder that was killed"
        raise RecordError(f"{path}: {cause}; make one by `rosbag reindex`") from None
    return closing(bag)


def _bounded(chunk: Any) -> Any:
    """The decompression of a chunk of a ROS 1 bag with a bound, instead of the one that has none."""
    if chunk.datasize > LARGEST_PART:
        raise ValueError(f"a chunk larger than {LARGEST_PART} bytes")
    module = getattr(chunk.decompressor, "__module__", "").partition(".")[0]
    compression = module if module in ("bz2", "lz4") else "none"
    return lambda data: decompress_part(data, compression)


def _read_databases(
    bag: Path, paths: Sequence[Path], unread: dict[str, str], release: str, messages: int = 0
) -> dict[str, LogTable]:
    topics = TopicRows(str(bag))
    for path in paths:
        with reading(path, "ROS 2 bag"), unpacked(path) as whole, opened_database(whole) as database:
            _read_database(database, path, topics, release)
    _check_count(bag, topics.count, messages)
    return {topic: _by_time(table) for topic, table in topics.tables(unread).items()}


def _read_database(database: sqlite3.Connection, path: Path, topics: TopicRows, release: str) -> None:
    """Adds the messages of a .db3 file to the rows of their topics."""
    database.execute("PRAGMA trusted_schema = OFF")
    tables = {name for (name,) in database.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    if not {"topics", "messages"} <= tables:
        raise ValueError("no tables of topics and messages")
    if "schema" in tables and not release:
        release = next((name for (name,) in database.execute("SELECT ros_distro FROM schema")), "")
    definitions: dict[str, tuple[str, str]] = {}
    if "message_definitions" in tables:
        query = "SELECT topic_type, encoded_message_definition, encoding FROM message_definitions"
        definitions = {name: (text, form) for name, text, form in database.execute(query)}
    decoders: dict[int, tuple[str, Sequence[Decoder]]] = {}
    for number, topic, kind, encoding in database.execute("SELECT id, name, type, serialization_format FROM topics"):
        text, form = definitions.get(kind, ("", ""))
        if encoding != "cdr":
            decoders[number] = topic, [unreadable(f"messages in {encoding!r:.60}, not read; those in CDR are")]
        else:
            decoders[number] = topic, _ros_decoders(path, encoding, kind, text, form, release)
    for number, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"):
        if number in decoders:
            topics.append(decoders[number][0], time, data, decoders[number][1])


def _by_time(table: LogTable) -> LogTable:
    """The table of several parts, ordered by time."""
    order = np.argsort(table.columns["log_time"], kind="stable")
    return replace(table, columns={name: values[order] for name, values in table.columns.items()})


def _ros_decoders(path: Path, encoding: str, name: str, definition: str, form: str, release: str = "") -> list[Decoder]:
    """The functions that may decode messages of a type.

    Args:
        encoding: That of the messages, cdr or ros1.
        definition: Its definition; an empty one is that of a type without fields, or missing.
        form: Language of the definition; one that is not of `_LANGUAGES` is none.
        release: Release of ROS 2 that recorded the log. If the definition is or may be missing, those of the release
            follow; of all releases, the newest first, if it is not known.
    """
    if (encoding, form) not in _LANGUAGES:
        return _standard_decoders(path, name, release)
    typesys = library("rosbags.typesys", path)
    text = definition.replace("\r\n", "\n")
    try:
        if form == "ros2idl":
            types = typesys.get_types_from_idl(_IDL_HEADER.sub("", text))
        else:
            types = typesys.get_types_from_msg(_RULE.sub("=" * 80, text), name)
    except Exception:
        return [unreadable(f"the definition of {name:.80} cannot be read")]
    decoders = [_decoder(path, name, types, cdr=encoding == "cdr")]
    if encoding == "cdr" and not text.strip():
        decoders += _standard_decoders(path, name, release)
    return decoders


def _standard_decoders(path: Path, name: str, release: str) -> list[Decoder]:
    """By the definitions in ROS 2 of a type which the log does not define."""
    typesys = library("rosbags.typesys", path)
    releases = {one.value.removeprefix("ros2_"): one for one in reversed(typesys.Stores) if one.name.startswith("ROS2")}
    chosen = [releases[release]] if release in releases else list(releases.values())
    definitions = [typesys.get_typestore(store).fielddefs for store in chosen]
    normal = library("rosbags.typesys.msg", path).normalize_msgtype(name)
    decoders = [_decoder(path, name, types) for types in definitions if normal in types]
    return decoders or [unreadable(f"no definition of {normal:.80} in the log")]


def _decoder(path: Path, name: str, types: Mapping[str, Any], cdr: bool = True) -> Decoder:
    """The function that decodes messages of a type, by definitions that rosbags parsed, in CDR or as of ROS 1."""
    node = library("rosbags.interfaces", path).Nodetype
    kind = node.NAME, library("rosbags.typesys.msg", path).normalize_msgtype(name)
    return lambda data: _Message(_unpacked_message(data), types, node, cdr).whole(kind)


def _unpacked_message(data: bytes) -> bytes:
    """The bytes of a message, which rosbag2 may have compressed by zstd; those in CDR begin with a zero."""
    return decompress_part(data, "zstd") if data.startswith(ZSTD_MAGIC) else data


class _Message:
    """Reads the bytes of a message from its begin to its end."""

    def __init__(self, data: bytes, types: Mapping[str, Any], node: Any, cdr: bool) -> None:
        self._data = data
        self._types = types
        self._node = node
        self._cdr = cdr
        self._offset = 0
        self._order = "<"
        if cdr:
            if len(data) < 4 or data[0] or data[1] > 1:
                raise ValueError(f"not in the plain CDR of ROS 2, but with the header {data[:4].hex() or 'missing'}")
            self._data = data[4:]
            self._order = "<" if data[1] else ">"

    def whole(self, kind: Any) -> Any:
        """The value of the type; all bytes must belong to it, but CDR may be padded to four bytes."""
        value = self._read(kind, 0)
        left = len(self._data) - self._offset
        if left and not (self._cdr and left == -self._offset % 4):
            raise ValueError(f"a message of {left} bytes more than the definition of {kind[1]} has")
        return value

    def _read(self, kind: Any, depth: int) -> Any:
        if depth > _DEEPEST:
            raise ValueError("a definition that is nested too deeply")
        tag, inner = kind
        if tag == self._node.BASE:
            return self._text() if inner[0] == "string" else self._numbers(self._code(inner[0]), 1)[0]
        if tag == self._node.NAME:
            return self._fields(inner, depth)
        element, count = inner
        if tag == self._node.SEQUENCE:
            (count,) = self._numbers("I", 1)
        if element[0] == self._node.BASE and element[1][0] != "string":
            return self._numbers(self._code(element[1][0]), count)
        if count > len(self._data):
            raise ValueError("an array longer than its message")
        return [self._read(element, depth + 1) for _ in range(count)]

    def _code(self, name: str) -> str:
        if name not in _NUMBERS:
            raise ValueError(f"a value of type {name}, which is not read")
        return "B" if self._cdr and name == "byte" else _NUMBERS[name]

    def _fields(self, name: str, depth: int) -> dict[str, Any]:
        if name not in self._types and name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
            seconds, nanoseconds = self._numbers("I" if name.endswith("Time") and not self._cdr else "i", 2)
            return {"sec": seconds, "nanosec": nanoseconds}
        if name not in self._types:
            raise ValueError(f"no definition of {name:.80} in the log")
        fields = self._types[name][1]
        if not fields and self._cdr:
            self._numbers("B", 1)  # a type without fields has a byte
        return {field: self._read(kind, depth + 1) for field, kind in fields}

    def _numbers(self, code: str, count: int) -> Sequence[Any]:
        width = struct.calcsize("<" + code)
        if self._cdr and count:
            self._offset += -self._offset % width
        start = self._offset
        self._offset += width * count
        if self._offset > len(self._data):
            raise ValueError("a message that is shorter than its definition")
        if count > MOST_ELEMENTS:
            return range(count)  # only its length matters: it does not become columns
        return struct.unpack_from(f"{self._order}{count}{code}", self._data, start)

    def _text(self) -> str:
        (length,) = self._numbers("I", 1)
        start = self._offset
        self._offset = self._offset + length
        if self._offset > len(self._data):
            raise ValueError("a message that is shorter than its definition")
        return self._data[start : self._offset].decode("utf-8", "replace").removesuffix("\0")
