"""The bytes of log files, with bounds on what is read and on what is decompressed."""

import zlib
from pathlib import Path

from stepgap.records.steps_csv import RecordError

LARGEST_LOG = 64 * 2**20
"""Largest text log that is read, decompressed [bytes]."""

LARGEST_FILE = 2**31
"""Largest log in a binary format [bytes]."""


def begin_of(path: Path) -> bytes:
    """The first 1024 bytes of a file.

    Raises:
        RecordError: It cannot be read, or is not a file.
    """
    try:
        if not path.is_file() and path.exists() and not path.is_dir():
            raise RecordError(f"{path}: not a file; give an existing log")
        with path.open("rb") as file:
            return file.read(1024)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; give an existing log, or the folder of a run") from None


def content_of(path: Path, largest: int) -> bytes:
    """The content of a file; one compressed by gzip is decompressed.

    Raises:
        RecordError: It cannot be read, is larger than `largest` [bytes], or is damaged.
    """
    try:
        with path.open("rb") as file:
            content = file.read(largest + 1)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; give an existing log, or the folder of a run") from None
    if content.startswith(b"\x1f\x8b"):
        content = _gunzipped(content, largest, path)
    if len(content) > largest:
        raise RecordError(f"{path}: larger than {largest} bytes, so it is not read")
    return content


def check_file_size(path: Path) -> None:
    """Raises RecordError if a file in a binary format is too large."""
    if path.stat().st_size > LARGEST_FILE:
        raise RecordError(f"{path}: larger than {LARGEST_FILE} bytes, so it is not read")


def _gunzipped(content: bytes, largest: int, path: Path) -> bytes:
    """What a gzip file of one or several members holds, at most one byte more than `largest`."""
    parts, size = [], 0
    while content and size <= largest:
        member = zlib.decompressobj(wbits=31)
        try:
            parts.append(member.decompress(content, largest + 1 - size))
        except zlib.error as error:
            raise RecordError(f"{path}: damaged gzip file ({error})") from None
        size += len(parts[-1])
        if size <= largest and not member.eof:
            raise RecordError(f"{path}: truncated gzip file")
        content = member.unused_data.lstrip(b"\0")
    return b"".join(parts)
