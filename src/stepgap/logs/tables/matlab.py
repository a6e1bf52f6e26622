"""MATLAB's MAT files up to version 7; files of version 7.3 are HDF5 files."""

import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.logs.tables.arrays import part_name, tables_of_arrays
from stepgap.logs.tables.files import content_of
from stepgap.logs.tables.libraries import leaving_out, reading
from stepgap.logs.tables.log_table import MOST_NUMBERS, LogTable, check_size
from stepgap.records.steps_csv import RecordError

_LARGEST_MAT = 16 * MOST_NUMBERS
"""Largest content of a MAT file, decompressed [bytes]."""

_COMPRESSED = 15


def read_mat(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The variables of a MAT file; those of a struct form a table of their own, such as `log` with column `v`.

    Variables that cannot be read are added to `unread`, with the reasons.
    """
    from scipy.io import loadmat, whosmat

    content = content_of(path, _LARGEST_MAT)
    with reading(path, "MAT"):
        content = _decompressed(content, path)
        arrays: list[tuple[str, str, Any]] = []
        for name, shape, _ in whosmat(BytesIO(content)):
            size = 1.0
            for length in shape:
                size *= length
            check_size(f"{path}, {name}", size)
            if name.startswith("__"):
                continue
            with leaving_out(name, unread):
                value = loadmat(BytesIO(content), variable_names=[name], struct_as_record=True, squeeze_me=False)[name]
                arrays += _arrays("", name, value, unread)
        return tables_of_arrays(str(path), arrays, unread)


def _decompressed(content: bytes, path: Path) -> bytes:
    """The same file with its variables decompressed, so that their sizes are known before they are read."""
    order = "big" if content[126:128] == b"MI" else "little"
    parts, at, size = [content[:128]], 128, 128
    while at < len(content):
        kind, length = (int.from_bytes(content[i : i + 4], order) for i in (at, at + 4))
        if at + 8 + length > len(content):
            raise RecordError(f"{path}: truncated MAT file")
        element = content[at : at + 8 + length]
        at += 8 + length
        if kind == _COMPRESSED:
            element = zlib.decompressobj().decompress(element[8:], _LARGEST_MAT + 1 - size)
        size += len(element)
        if size > _LARGEST_MAT:
            raise RecordError(f"{path}: larger than {_LARGEST_MAT} bytes when decompressed, so it is not read")
        parts.append(element)
    return b"".join(parts)


def _arrays(group: str, name: str, value: Any, unread: dict[str, str]) -> Iterator[tuple[str, str, Any]]:
    """Yields the arrays of a variable; a struct of one element has a table, its inner structs have NAME.FIELD."""
    if type(value) is not np.ndarray:
        unread[part_name(group, name)] = f"a {type(value).__name__}, neither numbers nor text"
    elif value.dtype.names and value.size == 1:
        for field in value.dtype.names:
            inner = value.reshape(-1)[0][field]
            yield from _arrays(group or name, f"{name}.{field}" if group else field, inner, unread)
    elif value.size:
        yield group, name, value
