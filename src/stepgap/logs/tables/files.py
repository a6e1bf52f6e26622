"""The bytes of log files, with bounds on what is read and decompressed; errors of libraries become one line."""

import bz2
import warnings
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.versions import optional_package
from stepgap.records.steps_csv import RecordError

LARGEST_LOG = 64 * 2**20  # Largest text log that is read, decompressed [bytes]
LARGEST_FILE = 2**31  # Largest log in a binary format [bytes]
LARGEST_PART = 2**28  # Largest chunk of a log after decompression [bytes]


def begin_of(path: Path) -> bytes:
    """The first 1024 bytes of a file.

    Raises:
        RecordError: It cannot be read, or is not a file.
    """
    if not path.is_file() and path.exists() and not path.is_dir():
        raise RecordError(f"{path}: not a file; give an existing log")
    return _read(path, 1024)


def content_of(path: Path, largest: int) -> bytes:
    """The content of a file; one compressed by gzip is decompressed.

    Raises:
        RecordError: It cannot be read, is larger than `largest` [bytes], or is damaged.
    """
    content = _read(path, largest + 1)
    if content.startswith(b"\x1f\x8b"):
        content = _gunzipped(content, largest, path)
    if len(content) > largest:
        raise RecordError(f"{path}: larger than {largest} bytes, so it is not read")
    return content


def _read(path: Path, most: int) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(most)
    except OSError as error:
        raise RecordError(f"{path}: {error.strerror}; give an existing log, or the folder of a run") from None


def check_file_size(path: Path) -> None:
    """Raises RecordError if a file in a binary format is too large."""
    if path.stat().st_size > LARGEST_FILE:
        raise RecordError(f"{path}: larger than {LARGEST_FILE} bytes, so it is not read")


def _gunzipped(content: bytes, largest: int, path: Path) -> bytes:
    """What a gzip file of one or several members holds, at most one byte more than `largest`.

    Of one that was cut off, it is what comes before the end, with a `StepGapWarning`.
    """
    parts = []
    size = 0
    while content and size <= largest:
        member = zlib.decompressobj(wbits=31)
        try:
            parts.append(member.decompress(content, largest + 1 - size))
        except zlib.error as error:
            raise RecordError(f"{path}: damaged gzip file ({error})") from None
        size += len(parts[-1])
        if size <= largest and not member.eof:
            if not size:
                raise RecordError(f"{path}: truncated gzip file")
            warnings.warn(f"{path}: truncated gzip file; what is before its end is read", StepGapWarning, stacklevel=2)
            break
        content = member.unused_data.lstrip(b"\0")
    return b"".join(parts)


def decompress_part(data: bytes, compression: str) -> bytes:
    """A chunk after decompression from "zstd", "lz4" or "bz2"; "" or "none" for bytes that are not compressed.

    Raises:
        ValueError: The compression is unknown, or the chunk is larger than `LARGEST_PART`.
    """
    if compression in ("", "none"):
        return data
    if compression == "zstd":
        return _zstandard(data)
    decompressor: Any
    if compression == "bz2":
        decompressor = bz2.BZ2Decompressor()
    elif compression == "lz4":
        from lz4.frame import LZ4FrameDecompressor

        decompressor = LZ4FrameDecompressor()
    else:
        raise ValueError(f"unknown compression {compression!r:.40}")
    return _whole(decompressor.decompress(data, LARGEST_PART + 1), decompressor.eof)


def _zstandard(data: bytes) -> bytes:
    import zstandard

    with zstandard.ZstdDecompressor(max_window_size=LARGEST_PART).stream_reader(data) as stream:
        content = stream.read(LARGEST_PART + 1)
    size = zstandard.get_frame_parameters(data).content_size
    return _whole(content, size in (zstandard.CONTENTSIZE_UNKNOWN, len(content)))


def _whole(content: bytes, is_whole: bool) -> bytes:
    if len(content) > LARGEST_PART:
        raise ValueError(f"a chunk larger than {LARGEST_PART} bytes when decompressed")
    if not is_whole:
        raise ValueError("a truncated chunk")
    return content


def library(name: str, path: Path, extra: str = "logs") -> Any:
    """A module of an optional package.

    Raises:
        RecordError: It is not installed; the message says which extra of this package installs it.
    """
    try:
        return optional_package(name, f"{path}: this format", extra)
    except InputError as error:
        raise RecordError(str(error)) from None


@contextmanager
def reading(path: Path, kind: str) -> Iterator[None]:
    """Turns any error of a library that reads untrusted bytes into one line.

    Raises:
        RecordError: An exception was raised inside; those that are a `RecordError` stay as they are.
    """
    try:
        yield
    except RecordError:
        raise
    except Exception as error:
        raise RecordError(f"{path}: not a readable {kind} file, damaged or incomplete ({cause_of(error)})") from None


@contextmanager
def leaving_out(part: str, unread: dict[str, str]) -> Iterator[None]:
    """Adds a part of a file to `unread`, with the reason, if it cannot be read.

    Raises:
        RecordError: One was raised inside: it is about the file as a whole.
    """
    try:
        yield
    except RecordError:
        raise
    except Exception as error:
        unread[part] = cause_of(error)


def cause_of(error: Exception) -> str:
    """One short line of an error."""
    return " ".join(str(error).split())[:120] or type(error).__name__
