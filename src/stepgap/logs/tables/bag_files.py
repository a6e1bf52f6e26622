"""The files of a ROS 2 bag: its parts, what belongs to a part beside it, and compressed parts."""

import re
import sqlite3
import struct
import warnings
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import BinaryIO

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.files import open_regular
from stepgap.logs.tables.files import LARGEST_FILE, LARGEST_PART, check_file_size, library
from stepgap.records.steps_csv import RecordError

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

METADATA = "metadata.yaml"

_LARGEST_METADATA = 2**24  # Of larger files only the beginning is read [bytes]

_LOGS = ("-wal", "-journal")
"""Ends of the names of files beside a database, without which it is not complete: SQLite writes its changes there."""

# The write-ahead log of SQLite: length of its header, and of the header of a frame, both with two random numbers.
_WAL_HEADER = 32
_FRAME_HEADER = 24
_PAGES = (512, 65536)  # Smallest and largest page
_BLOCK = 2**20  # Number of bytes that are copied at once


def parts_of(folder: Path) -> tuple[list[Path], list[Path]]:
    """The parts of a bag in MCAP and in SQLite, compressed ones among them if there is no other copy."""
    return _of_format(folder, ".mcap"), _of_format(folder, ".db3")


def _of_format(folder: Path, end: str) -> list[Path]:
    plain = sorted(folder.glob(f"*{end}"))
    packed = sorted(folder.glob(f"*{end}.zstd"))
    return sorted([*plain, *(path for path in packed if path.with_suffix("") not in plain)])


def metadata_in(folder: Path) -> str:
    """The metadata of a bag; empty if there are none."""
    try:
        with open_regular(folder / METADATA) as file:
            return file.read(_LARGEST_METADATA).decode("utf-8", "replace")
    except (OSError, InputError):
        return ""


def release_in(metadata: str) -> str:
    """Release of ROS 2 that recorded a bag, such as humble; empty if its metadata do not say it."""
    release = re.search(r"^\s*ros_distro:\s*[\"']?(\w+)", metadata, re.MULTILINE)
    return release[1] if release else ""


def messages_in(metadata: str) -> int:
    """Number of messages in a bag; 0 if its metadata do not say it."""
    count = re.search(r"^ {0,2}message_count:\s*(\d{1,18})\s*$", metadata, re.MULTILINE)
    return int(count[1]) if count else 0


def missing_files(folder: Path, metadata: str) -> dict[str, str]:
    """The parts that are named in the metadata, but not in the folder, with the reason for which they are left out."""
    there = {path.name for path in folder.iterdir()}
    lost = [name for name in _names_in(metadata) if not {name, f"{name}.zstd", name.removesuffix(".zstd")} & there]
    return dict.fromkeys(lost, f"a part of the bag, by {METADATA}, but missing")


def other_parts(part: Path) -> dict[str, str]:
    """The parts that are in one bag with this one, with the reason for which they are left out."""
    numbered = re.fullmatch(r"(.*)_\d+(\.(db3|mcap)(\.zstd)?)", part.name)
    named = _names_in(metadata_in(part.parent))
    if part.name not in named and numbered and numbered[1] == part.resolve().parent.name:  # as rosbag2 calls them
        alike = re.compile(re.escape(numbered[1]) + r"_\d+" + re.escape(numbered[2]))
        named = sorted(path.name for path in part.parent.iterdir() if alike.fullmatch(path.name))
    return {name: "another part of this bag; give its folder to read all" for name in named if name != part.name}


def _names_in(metadata: str) -> list[str]:
    """Names of the parts in the metadata, without those of folders."""
    entries = re.search(r"^\s*relative_file_paths:[ \t]*\n((?:[ \t]*-[ \t].*\n?)*)", metadata, re.MULTILINE)
    lines = entries[1].splitlines() if entries else []
    return [Path(line.strip().removeprefix("-").strip(" \t\"'")).name for line in lines]


@contextmanager
def unpacked(path: Path) -> Iterator[Path]:
    """Gives a part of a bag; of one that is compressed by zstd, a copy that is not.

    Raises:
        RecordError: The copy would be larger than `LARGEST_FILE`, or cannot be written.
    """
    check_file_size(path)
    with path.open("rb") as file:
        if file.read(len(ZSTD_MAGIC)) != ZSTD_MAGIC:
            yield path
            return
        file.seek(0)
        zstandard = library("zstandard", path)
        with TemporaryDirectory() as folder:
            copy = Path(folder) / path.name.removesuffix(".zstd")
            packer = zstandard.ZstdDecompressor(max_window_size=LARGEST_PART)
            with packer.stream_reader(file, read_across_frames=True) as stream:
                _copy(stream, copy, path)
            yield copy


def begin_of_packed(path: Path) -> bytes:
    """The first bytes of what a file that is compressed by zstd holds; none if it is damaged."""
    zstandard = library("zstandard", path)
    with path.open("rb") as file:
        try:
            return zstandard.ZstdDecompressor(max_window_size=LARGEST_PART).stream_reader(file).read(16)
        except zstandard.ZstdError:
            return b""


def _copy(source: BinaryIO, copy: Path, path: Path) -> None:
    """Copies what is left of `source`, which is a part of the log at `path`."""
    size = 0
    try:
        with copy.open("wb") as file:
            while part := source.read(_BLOCK):
                size += len(part)
                if size > LARGEST_FILE:
                    raise RecordError(f"{path}: larger than {LARGEST_FILE} bytes when decompressed, so it is not read")
                file.write(part)
    except OSError as error:
        raise RecordError(f"{path}: cannot be copied to a temporary folder ({error.strerror})") from None


@contextmanager
def opened_database(path: Path) -> Iterator[sqlite3.Connection]:
    """A database with the changes that are in files beside it, such as those of a recorder that was killed.

    Nothing is written beside it: it is copied if there are such files. A `StepGapWarning` says if a part of them is
    damaged.

    Raises:
        RecordError: It cannot be copied.
        sqlite3.Error: It is damaged.
    """
    real = path.resolve()
    beside = [real.with_name(real.name + end) for end in _LOGS]
    beside = [log for log in beside if log.is_file() and log.stat().st_size]
    if not beside:
        with closing(sqlite3.connect(f"{real.as_uri()}?mode=ro&immutable=1", uri=True)) as database:
            yield database
        return
    with TemporaryDirectory() as folder:
        for source in (real, *beside):
            check_file_size(source)
            with open_regular(source) as file:
                _copy(file, Path(folder) / source.name, source)
        with closing(sqlite3.connect(Path(folder) / real.name)) as database:
            if beside[0].name.endswith(_LOGS[0]):
                _check_used(database, beside[0])
            yield database


def _check_used(database: sqlite3.Connection, log: Path) -> None:
    """Warns if not all of a write-ahead log is used, because it is damaged or another database's."""
    pages = _pages_in(log)
    database.execute("SELECT count(*) FROM sqlite_master").fetchone()
    (_, used, _) = database.execute("PRAGMA wal_checkpoint").fetchone()
    if used < pages:
        lost = f"{pages - max(used, 0)} of its {pages} pages are not whole, so their messages are not read"
        warnings.warn(f"{log}: {lost}", StepGapWarning, stacklevel=2)


def _pages_in(log: Path) -> int:
    """Number of pages that were written to a write-ahead log since it was begun anew."""
    with open_regular(log) as file:
        header = file.read(_WAL_HEADER)
        if len(header) < _WAL_HEADER:
            return 0
        (size,) = struct.unpack_from(">I", header, 8)
        pages = 0
        if not _PAGES[0] <= size <= _PAGES[1]:
            return 1  # a damaged one
        while file.read(_FRAME_HEADER)[8:16] == header[16:24]:
            pages += 1
            file.seek(size, 1)
        return pages
