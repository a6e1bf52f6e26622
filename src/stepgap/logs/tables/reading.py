"""A log of any format as tables: the format is found from the content, not from the name."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from stepgap.base.errors import StepGapWarning
from stepgap.base.files import GIT_LFS, NOT_FETCHED
from stepgap.logs.tables.arrays import NPY_MAGIC, read_npy, read_npz
from stepgap.logs.tables.bag_files import ZSTD_MAGIC, begin_of_packed
from stepgap.logs.tables.bags import (
    MCAP_MAGIC,
    ROS1_MAGIC,
    SQLITE_MAGIC,
    is_ros2_folder,
    read_part_in_mcap,
    read_ros1_bag,
    read_ros2_database,
    read_ros2_folder,
)
from stepgap.logs.tables.files import LARGEST_LOG, begin_of, content_of
from stepgap.logs.tables.foreign_files import read_foreign_file
from stepgap.logs.tables.hdf5 import HDF5_MAGIC
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.matlab import is_mat4
from stepgap.logs.tables.messages import read_json_lines
from stepgap.logs.tables.other_formats import kind_of_other
from stepgap.logs.tables.parquet_logs import FEATHER_MAGIC, PARQUET_MAGIC
from stepgap.logs.tables.text import AS_FOUND, TextFormat, decoded, read_delimited_text
from stepgap.records.steps_csv import RecordError

NO_ROLES: Mapping[str, str] = MappingProxyType({})  # Columns whose meaning is not known


def read_log_tables(path: str | Path, written: TextFormat = AS_FOUND) -> Mapping[str, LogTable]:
    """Reads all tables of a log.

    A part that cannot be read, such as a topic or a column, is left out; a `StepGapWarning` names it, and so does the
    message if it is asked for.

    Args:
        written: How the numbers of a text file are written.

    Returns:
        The tables by topic or group; by "" for the only table of a file without topics.

    Raises:
        RecordError: Nothing in the file can be read; the message is one line that names it.
    """
    path = Path(path)
    unread = dict[str, str]()
    if is_ros2_folder(path):
        tables = read_ros2_folder(path, unread)
    else:
        begin = begin_of(path)
        tables = _binary_tables(path, begin, unread)
        if tables is None and (kind := kind_of_other(begin)):
            raise RecordError(f"{path}: {kind}")
    if tables is None:
        content = content_of(path, LARGEST_LOG)
        if content.startswith(GIT_LFS):
            raise RecordError(f"{path}: {NOT_FETCHED}")
        text = decoded(content, written.encoding, str(path))
        if text.lstrip().startswith("{"):
            return {"": read_json_lines(text, str(path))}
        return {"": read_delimited_text(text, written, str(path))}
    if not unread:
        return tables
    parts = [f"{part} ({reason})" if part else reason for part, reason in unread.items()]
    left_out = [" ".join(part.split()) for part in parts]  # names in a damaged file may have line ends
    if not tables:
        raise RecordError(f"{path}: nothing in it can be read: {', '.join(left_out):.300}")
    warnings.warn(f"{path}: left out {', '.join(left_out):.500}", StepGapWarning, stacklevel=2)
    return {name: replace(table, unread={**table.unread, **unread}) for name, table in tables.items()}


def _binary_tables(path: Path, begin: bytes, unread: dict[str, str]) -> Mapping[str, LogTable] | None:
    """The tables of a file in a binary format, found from its first bytes; None for text."""
    if begin.startswith(ZSTD_MAGIC):
        begin = begin_of_packed(path)
        if not begin.startswith((MCAP_MAGIC, SQLITE_MAGIC)):
            raise RecordError(f"{path}: compressed by zstd; unpack it by `unzstd` before")
    if begin.startswith(MCAP_MAGIC):
        return read_part_in_mcap(path, unread)
    if begin.startswith(ROS1_MAGIC):
        return read_ros1_bag(path, unread)
    if begin.startswith(SQLITE_MAGIC):
        return read_ros2_database(path, unread)
    if begin.startswith(NPY_MAGIC):
        return read_npy(path, unread)
    if begin.startswith(b"PK\x03\x04"):
        return read_npz(path, unread)
    kind = _foreign_kind(begin)
    return read_foreign_file(kind, path, unread) if kind else None


def _foreign_kind(begin: bytes) -> str:
    """The kind of a file that is read in another process; empty for others."""
    if begin.startswith(PARQUET_MAGIC):
        return "Parquet"
    if begin.startswith(FEATHER_MAGIC):
        return "Feather"
    if begin.startswith(b"MATLAB 7.3 MAT-file"):
        return "MAT 7.3"
    if HDF5_MAGIC in (begin[:8], begin[512:520]):
        return "HDF5"
    is_mat = begin[126:128] in (b"MI", b"IM") and b"\0" in begin
    return "MAT" if is_mat or is_mat4(begin) else ""


def read_log_table(path: str | Path, wanted: Sequence[str], written: TextFormat = AS_FOUND) -> LogTable:
    """Reads the one table of a log that has the wanted columns.

    A column may be given as TOPIC:COLUMN; the table then has it by this name, too.

    Raises:
        RecordError: The file cannot be read, or not exactly one of its tables has these columns.
    """
    return chosen_table(Path(path), read_log_tables(path, written), wanted)


def chosen_table(
    path: Path, tables: Mapping[str, LogTable], wanted: Sequence[str], roles: Mapping[str, str] = NO_ROLES
) -> LogTable:
    """The one table that has the wanted columns; with their roles the message about one that is missing is clearer.

    Raises:
        RecordError: None or several have them.
    """
    if not tables:
        raise RecordError(f"{path}: no table of numbers in this file")
    named = {topic: with_topic(topic, table) for topic, table in tables.items()}
    missing = {topic: [name for name in wanted if table.fault_of(name)] for topic, table in named.items()}
    topics = [topic for topic, names in missing.items() if not names]
    if len(topics) == 1:
        return named[topics[0]]
    if topics:
        example = f"{topics[0]}:{wanted[0]}" if wanted else topics[0]
        raise RecordError(f"{path}: {', '.join(topics):.200} have these columns; say which, as in {example!r}")
    closest = min(named, key=lambda topic: len(missing[topic]))
    table = named[closest]
    name = missing[closest][0]
    fault = named[closest].known_fault_of(name) or tables[closest].fault_of(name)
    role = f"{roles[name]} {name!r}: " if name in roles else ""
    others = [topic for topic in tables if topic != closest]
    more = f"; other tables are {', '.join(others):.200}" if others else ""
    raise RecordError(f"{table.heading or table.source}: {role}{fault}{more}")


def with_topic(topic: str, table: LogTable) -> LogTable:
    """The table with its columns also as TOPIC:COLUMN."""
    if not topic:
        return table
    columns = dict(table.columns) | {f"{topic}:{name}": values for name, values in table.columns.items()}
    repeated = table.repeated | {f"{topic}:{name}" for name in table.repeated}
    return replace(table, columns=columns, repeated=repeated)
