"""Bags of ROS 1 and of ROS 2."""

import re
import sqlite3
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.logs.tables.files import LARGEST_FILE, LARGEST_PART, check_file_size, decompress_part, library, reading
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.mcap_logs import read_mcap
from stepgap.logs.tables.messages import Decoder, TopicRows, unreadable
from stepgap.logs.tables.ros_messages import defined_decoders, standard_decoders
from stepgap.records.steps_csv import RecordError

ROS1_MAGIC = b"#ROSBAG V"
SQLITE_MAGIC = b"SQLite format 3\0"

_METADATA = "metadata.yaml"


def is_ros2_folder(path: Path) -> bool:
    """Whether a folder is a ROS 2 bag: it has its metadata, or at least its parts."""
    return path.is_dir() and ((path / _METADATA).is_file() or any(_parts(path)))


def _parts(path: Path) -> tuple[list[Path], list[Path]]:
    """The parts of a ROS 2 bag in MCAP and in SQLite."""
    return sorted(path.glob("*.mcap")), sorted(path.glob("*.db3"))


def read_ros2_folder(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a ROS 2 bag: a folder with metadata.yaml and parts in MCAP or SQLite.

    Topics that cannot be read are added to `unread`, with the reasons.
    """
    mcaps, databases = _parts(path)
    if bool(mcaps) == bool(databases):
        raise RecordError(
            f"{path}: a ROS 2 bag must have .mcap or .db3 files, not both; compressed ones are to be unpacked before"
        )
    release = _release_in(path / _METADATA)
    tables = read_mcap(mcaps, unread, release) if mcaps else _read_databases(path, databases, unread, release)
    return {topic: _by_time(table) for topic, table in tables.items()}


def read_ros2_database(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a .db3 file, which is a part of a ROS 2 bag; `unread` as of `read_ros2_folder`."""
    return _read_databases(path, [path], unread, _release_in(path.parent / _METADATA))


def read_ros1_bag(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The topics of a ROS 1 bag; `unread` as of `read_ros2_folder`."""
    rosbag1 = library("rosbags.rosbag1", path)
    check_file_size(path)
    topics = TopicRows(str(path))
    decoders = dict[int, list[Decoder]]()
    size = 0
    with reading(path, "ROS 1 bag"), rosbag1.Reader(path) as bag:
        bag.chunks = {at: chunk._replace(decompressor=_bounded(chunk)) for at, chunk in bag.chunks.items()}
        for connection, time, data in bag.messages():
            size += len(data)
            if size > LARGEST_FILE:
                raise ValueError(f"more than {LARGEST_FILE} bytes of messages")
            if connection.id not in decoders:
                definition = connection.msgtype, connection.msgdef.data
                decoders[connection.id] = defined_decoders(path, *definition, "ros1msg")
            topics.append(connection.topic, time, data, decoders[connection.id])
    return topics.tables(unread)


def _bounded(chunk: Any) -> Any:
    """The decompression of a chunk of a ROS 1 bag with a bound, instead of the one that has none."""
    if chunk.datasize > LARGEST_PART:
        raise ValueError(f"a chunk larger than {LARGEST_PART} bytes")
    module = getattr(chunk.decompressor, "__module__", "").partition(".")[0]
    compression = module if module in ("bz2", "lz4") else "none"
    return lambda data: decompress_part(data, compression)


def _release_in(metadata: Path) -> str:
    """Release of ROS 2 that recorded a bag, such as humble; empty if its metadata do not say it."""
    try:
        text = metadata.read_text("utf-8", "replace")[:LARGEST_PART]
    except OSError:
        return ""
    found = re.search(r"^\s*ros_distro:\s*[\"']?(\w+)", text, re.MULTILINE)
    return found[1] if found else ""


def _read_databases(bag: Path, paths: Sequence[Path], unread: dict[str, str], release: str) -> dict[str, LogTable]:
    """The topics of .db3 files, parts of one bag."""
    topics = TopicRows(str(bag))
    for path in paths:
        check_file_size(path)
        uri = f"{path.absolute().as_uri()}?mode=ro&immutable=1"
        with reading(path, "ROS 2 bag"), closing(sqlite3.connect(uri, uri=True)) as database:
            _read_database(database, path, topics, release)
    return topics.tables(unread)


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
        elif form in ("ros2msg", "ros2idl"):
            decoders[number] = topic, defined_decoders(path, kind, text, form, release)
        else:
            decoders[number] = topic, standard_decoders(path, kind, release)
    for number, time, data in database.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY timestamp, id"):
        if number in decoders:
            topics.append(decoders[number][0], time, data, decoders[number][1])


def _by_time(table: LogTable) -> LogTable:
    """The table of several parts, ordered by time."""
    order = np.argsort(table.columns["log_time"], kind="stable")
    return replace(table, columns={name: values[order] for name, values in table.columns.items()})
