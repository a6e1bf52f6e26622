"""MATLAB's MAT files up to version 7; files of version 7.3 are HDF5 files."""

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.logs.tables.arrays import only_for_matlab, part_name, tables_of_arrays
from stepgap.logs.tables.files import content_of, leaving_out, reading
from stepgap.logs.tables.log_table import MOST_NUMBERS, LogTable, check_size
from stepgap.records.steps_csv import RecordError

_LARGEST_MAT = 16 * MOST_NUMBERS
"""Largest content of a MAT file, decompressed [bytes]."""

_COMPRESSED, _HEADER_5, _HEADER_4 = 15, 128, 20
"""Kind of an element that is compressed, and the lengths of headers in versions 5 to 7 and in version 4 [bytes]."""


def is_mat4(begin: bytes) -> bool:
    """Whether a file begins as one of version 4: with five numbers and the name of a variable."""
    for order in "<>" if len(begin) > _HEADER_4 else "":
        kind, rows, columns, imaginary, length = struct.unpack_from(f"{order}5i", begin)
        is_kind = kind // 1000 == (order == ">") and kind % 1000 < 60 and kind % 10 < 3
        if is_kind and rows >= 0 and columns >= 0 and imaginary in (0, 1) and 0 < length <= 64:
            return begin[_HEADER_4 + length - 1] == 0 and begin[_HEADER_4 : _HEADER_4 + length - 1].isalnum()
    return False


def read_mat(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The variables of a MAT file; those of a struct form a table of their own, such as `log` with column `v`.

    Variables that cannot be read are added to `unread`, with the reasons.
    """
    content = content_of(path, _LARGEST_MAT)
    arrays: list[tuple[str, str, Any]] = []
    with reading(path, "MAT"):
        for number, part in enumerate([content] if is_mat4(content) else _variables(content, path), 1):
            with leaving_out(f"variable {number}", unread):
                arrays += _arrays_of(part, path, unread)
        return tables_of_arrays(str(path), arrays, unread)


def _variables(content: bytes, path: Path) -> Iterator[bytes]:
    """Yields a file of its own for each variable of a file of version 5, as it is stored."""
    order = "big" if content[126:128] == b"MI" else "little"
    at = _HEADER_5
    while at < len(content):
        length = int.from_bytes(content[at + 4 : at + 8], order)
        if at + 8 + length > len(content):
            raise RecordError(f"{path}: truncated MAT file")
        yield content[:_HEADER_5] + content[at : at + 8 + length]
        at += 8 + length


def _decompressed(content: bytes, path: Path) -> bytes:
    """The same file with its variable decompressed, so that its size is known before it is read."""
    order = "big" if content[126:128] == b"MI" else "little"
    if is_mat4(content) or int.from_bytes(content[_HEADER_5 : _HEADER_5 + 4], order) != _COMPRESSED:
        return content
    element = zlib.decompressobj().decompress(content[_HEADER_5 + 8 :], _LARGEST_MAT + 1)
    if len(element) > _LARGEST_MAT:
        raise RecordError(f"{path}: larger than {_LARGEST_MAT} bytes when decompressed, so it is not read")
    return content[:_HEADER_5] + element


def _arrays_of(content: bytes, path: Path, unread: dict[str, str]) -> Iterator[tuple[str, str, Any]]:
    """Yields the arrays of a file's variables."""
    from scipy.io import loadmat, whosmat

    content = _decompressed(content, path)
    try:
        listed = whosmat(BytesIO(content))
    except TypeError:  # an object of a class has no size
        name, _, kind = next(iter(loadmat(BytesIO(content))["None"].tolist()))[:3]
        unread[name.decode()] = only_for_matlab(kind.decode())
        return
    for name, shape, _ in listed:
        size = 1.0
        for length in shape:
            size *= length
        check_size(f"{path}, {name}", size)
        if not name.startswith("__"):
            with leaving_out(name, unread):
                value = loadmat(BytesIO(content), variable_names=[name], simplify_cells=True)[name]
                yield from _arrays("", name, value, unread)


def _arrays(group: str, name: str, value: Any, unread: dict[str, str]) -> Iterator[tuple[str, str, Any]]:
    """Yields the arrays of a variable; a struct has a table, its inner structs have NAME.FIELD or NAME[0].FIELD."""
    if isinstance(value, dict):
        for field, inner in value.items():
            yield from _arrays(group or name, f"{name}.{field}" if group else field, inner, unread)
    elif isinstance(value, list):
        for index, inner in enumerate(value):
            yield from _arrays(group, f"{name}[{index}]", inner, unread)
    elif type(value) is np.ndarray:
        if value.size:
            yield group, name, value
    elif not np.isscalar(value):
        unread[part_name(group, name)] = f"a {type(value).__name__}, neither numbers nor text"
