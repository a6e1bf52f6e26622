"""Bags of ROS 1 and of ROS 2."""

import struct
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.logs.tables.decompression import LARGEST_PART, decompress_part
from stepgap.logs.tables.files import LARGEST_FILE, check_file_size
from stepgap.logs.tables.libraries import library, reading
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.mcap_logs import cdr_decoder, read_mcap
from stepgap.logs.tables.messages import MOST_ELEMENTS, MessageRows, row_of_message
from stepgap.records.steps_csv import RecordError

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


def read_ros2_folder(path: Path) -> dict[str, LogTable]:
    """The topics of a ROS 2 bag: a folder with metadata.yaml and parts in MCAP or SQLite."""
    mcaps, databases = sorted(path.glob("*.mcap")), sorted(path.glob("*.db3"))
    if bool(mcaps) == bool(databases):
        raise RecordError(
            f"{path}: a ROS 2 bag must have .mcap or .db3 files; compressed ones are to be unpacked before"
        )
    if mcaps:
        return _by_time(read_mcap(mcaps))
    topics: dict[str, MessageRows] = {}
    for database in databases:
        _read_database(database, topics, path)
    return _by_time({topic: rows.table(has_lines=False) for topic, rows in topics.items()})


def read_ros2_database(path: Path) -> dict[str, LogTable]:
    """The topics of a .db3 file, which is a part of a ROS 2 bag."""
    topics: dict[str, MessageRows] = {}
    _read_database(path, topics, path)
    return {topic: rows.table(has_lines=False) for topic, rows in topics.items()}


def read_ros1_bag(path: Path) -> dict[str, LogTable]:
    """The topics of a ROS 1 bag."""
    rosbag1, interfaces = library("rosbags.rosbag1", path), library("rosbags.interfaces", path)
    typesys = library("rosbags.typesys", path)
    check_file_size(path)
    topics: dict[str, MessageRows] = {}
    with reading(path, "ROS 1 bag"), rosbag1.Reader(path) as bag:
        bag.chunks = {at: chunk._replace(decompressor=_bounded(chunk)) for at, chunk in bag.chunks.items()}
        types: dict[int, dict[str, Any]] = {}
        size = 0
        for connection, time, data in bag.messages():
            size += len(data)
            if size > LARGEST_FILE:
                raise ValueError(f"more than {LARGEST_FILE} bytes of messages")
            if connection.id not in types:
                types[connection.id] = typesys.get_types_from_msg(connection.msgdef.data, connection.msgtype)
            message = _Ros1Message(data, types[connection.id], interfaces.Nodetype)
            tree = message.read((interfaces.Nodetype.NAME, connection.msgtype), 0)
            rows = topics.setdefault(connection.topic, MessageRows(f"{path}, {connection.topic}"))
            rows.append(row_of_message(time, tree))
    return {topic: rows.table(has_lines=False) for topic, rows in topics.items()}


def _bounded(chunk: Any) -> Any:
    """The decompression of a chunk of a ROS 1 bag with a bound, instead of the one that has none."""
    if chunk.datasize > LARGEST_PART:
        raise ValueError(f"a chunk larger than {LARGEST_PART} bytes")
    module = getattr(chunk.decompressor, "__module__", "")
    compression = "bz2" if module == "bz2" else "lz4" if module.startswith("lz4") else "none"
    return lambda data: decompress_part(data, compression)


class _Ros1Message:
    """Reads a message by the definition in the bag.

    rosbags would compile Python code made from that definition; a log should not lead to code that runs.
    """

    def __init__(self, data: bytes, types: dict[str, Any], node: Any) -> None:
        self._data, self._types, self._node, self._offset = data, types, node, 0

    def read(self, kind: Any, depth: int) -> Any:
        """The value of a type at the current offset, which it increases."""
        if depth > 50:
            raise ValueError("a message definition that is nested too deeply")
        tag, inner = kind
        if tag == self._node.BASE:
            return self._text() if inner[0] == "string" else self._numbers(_NUMBERS[inner[0]], 1)[0]
        if tag == self._node.NAME:
            return self._message(inner, depth)
        element, count = inner
        if tag == self._node.SEQUENCE:
            (count,) = self._numbers("I", 1)
        if element[0] == self._node.BASE and element[1][0] != "string":
            return self._numbers(_NUMBERS[element[1][0]], count)
        if count > len(self._data):
            raise ValueError("an array longer than its message")
        return [self.read(element, depth + 1) for _ in range(count)]

    def _message(self, name: str, depth: int) -> dict[str, Any]:
        if name in ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration"):
            seconds, nanoseconds = self._numbers("I" if name.endswith("Time") else "i", 2)
            return {"sec": seconds, "nanosec": nanoseconds}
        return {field: self.read(kind, depth + 1) for field, kind in self._types[name][1]}

    def _numbers(self, code: str, count: int) -> tuple[Any, ...]:
        start, size = self._offset, count * struct.calcsize("<" + code)
        self._offset += size
        if self._offset > len(self._data):
            raise ValueError("a message that is too short")
        return struct.unpack_from(f"<{count}{code}", self._data, start) if count <= MOST_ELEMENTS else ()

    def _text(self) -> str:
        (length,) = self._numbers("I", 1)
        start, self._offset = self._offset, self._offset + length
        if self._offset > len(self._data):
            raise ValueError("a message that is too short")
        return self._data[start : self._offset].decode("utf-8", "replace")


def _read_database(path: Path, topics: dict[str, MessageRows], bag: Path) -> None:
    """Adds the messages of a .db3 file to the rows of their topics."""
    rosbag2, typesys = library("rosbags.rosbag2.storage_sqlite3", path), library("rosbags.typesys", path)
    check_file_size(path)
    with reading(path, "ROS 2 bag"):
        storage = rosbag2.Sqlite3Reader(path)
        storage.open()
        try:
            store = typesys.get_typestore(typesys.Stores.LATEST)
            decoders = {
                connection.id: cdr_decoder(*_definition(connection, store), path) for connection in storage.connections
            }
            for connection, time, data in storage.messages(storage.connections):
                rows = topics.setdefault(connection.topic, MessageRows(f"{bag}, {connection.topic}"))
                rows.append(row_of_message(time, decoders[connection.id](data)))
        finally:
            storage.close()


def _definition(connection: Any, store: Any) -> tuple[str, str]:
    """Name and definition of a message type: from the bag, or for the older ones without it the standard type."""
    definition = connection.msgdef.data
    if connection.msgdef.format.name == "NONE":
        if connection.msgtype not in store.fielddefs:
            raise ValueError(f"no definition of {connection.msgtype} in the bag")
        definition = store.generate_msgdef(connection.msgtype, ros_version=2)[0]
    elif connection.msgdef.format.name != "MSG":
        raise ValueError(f"{connection.msgtype} is defined in IDL, which is not read")
    return connection.msgtype, definition


def _by_time(tables: dict[str, LogTable]) -> dict[str, LogTable]:
    """The tables of several parts, ordered by time."""
    ordered = {}
    for topic, table in tables.items():
        order = np.argsort(table.columns["log_time"], kind="stable")
        ordered[topic] = LogTable(table.source, {name: values[order] for name, values in table.columns.items()})
    return ordered
