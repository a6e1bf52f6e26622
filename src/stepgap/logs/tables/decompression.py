"""Decompression of parts of a file that cannot make more bytes than a bound."""

import bz2
from typing import Any

LARGEST_PART = 2**28
"""Largest chunk of a log after decompression [bytes]."""


def decompress_part(data: bytes, compression: str) -> bytes:
    """A decompressed chunk.

    Args:
        data: The compressed bytes.
        compression: "zstd", "lz4" or "bz2"; "" or "none" for bytes that are not compressed.

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
