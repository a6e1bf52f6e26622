"""MATLAB's MAT files up to version 7; files of version 7.3 are HDF5 files."""

import struct
import warnings
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.arrays import only_for_matlab, part_name, tables_of_arrays
from stepgap.logs.tables.files import content_of, leaving_out, reading
from stepgap.logs.tables.log_table import MOST_NUMBERS, LogTable, check_size
from stepgap.records.steps_csv import RecordError

_LARGEST_MAT = 16 * MOST_NUMBERS  # Largest content of a MAT file, decompressed [bytes]

# Lengths of headers in versions 5 to 7, and in version 4 [bytes].
_HEADER_5 = 128
_HEADER_4 = 20
# Types of elements, and all of them.
_COMPRESSED = 15
_MATRIX = 14
_INT32 = 5
_UINT32 = 6
_KINDS = frozenset([*range(1, 8), 9, *range(12, 15), *range(16, 19)])
# Classes of matrices.
_CELL = 1
_STRUCT = 2
_SPARSE = 5
_OBJECT = 17
_NUMERIC = range(4, 16)

_DEEPEST_MAT = 50


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
            if at == _HEADER_5:
                raise RecordError(f"{path}: truncated MAT file")
            warnings.warn(f"{path}: truncated MAT file; the variables before its end are read", StepGapWarning, 2)
            return
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
    from scipy.io import loadmat, whosmat

    content = _decompressed(content, path)
    if not is_mat4(content):
        order = ">" if content[126:128] == b"MI" else "<"
        for element in _elements(content, _HEADER_5, len(content), order):
            _check_matrix(content, element, order)
    for name, shape, _ in whosmat(BytesIO(content)):
        check_size(f"{path}, {name}", prod(map(float, shape)))
        if not name.startswith("__"):
            with leaving_out(name, unread):
                value = loadmat(BytesIO(content), variable_names=[name], simplify_cells=True)[name]
                yield from _arrays("", name, value, unread)


def _arrays(group: str, name: str, value: Any, unread: dict[str, str]) -> Iterator[tuple[str, str, Any]]:
    """Yields the arrays of a variable; a struct has a table, its inner structs have NAME.FIELD or NAME[0].FIELD."""
    if isinstance(value, dict):
        for field, inner in value.items():
            yield from _arrays(group or name, f"{name}.{field}" if group else field, inner, unread)
    elif isinstance(value, list) or (type(value) is np.ndarray and any(map(_is_array, _cells(value)))):
        for index, inner in enumerate(_cells(value)):
            yield from _arrays(group, f"{name}[{index}]", inner, unread)
    elif type(value) is np.ndarray:
        if value.size:
            yield group, name, value
    elif not np.isscalar(value):
        unread[part_name(group, name)] = f"a {type(value).__name__}, neither numbers nor text"


def _cells(value: Any) -> Sequence[Any]:
    """The parts of a list, or of a cell array; none of an array of numbers."""
    if isinstance(value, list):
        return value
    return value.ravel(order="F").tolist() if value.dtype.kind == "O" else []


def _is_array(value: Any) -> bool:
    return isinstance(value, dict | list | np.ndarray)


class _Element(NamedTuple):
    """A part of a file of version 5: its type, and where its content begins and ends."""

    kind: int
    begin: int
    end: int


def _elements(content: bytes, begin: int, end: int, order: str) -> list[_Element]:
    """The successive elements between two places.

    Raises:
        ValueError: One has an unknown type or ends elsewhere.
    """
    elements: list[_Element] = []
    at = begin
    while at < end:
        kind, length = struct.unpack_from(f"{order}II", content, at)
        if kind >> 16:  # a short element, whose content is in the place of its length
            element = _Element(kind & 0xFFFF, at + 4, at + 4 + (kind >> 16))
            is_whole = element.kind != _MATRIX and element.end <= at + 8
            at += 8
        else:
            element = _Element(kind, at + 8, at + 8 + length)
            is_whole = True
            at = element.end + -length % 8
        if element.kind not in _KINDS or element.end > end or not is_whole:
            raise ValueError("damaged: an element of a type or length that there is not")
        elements.append(element)
    return elements


def _check_matrix(content: bytes, matrix: _Element, order: str, depth: int = 0) -> None:
    """Checks the types and numbers of all elements in a matrix, which scipy takes for granted.

    It indexes an array of C by a type, so a wrong one would end the process.

    Raises:
        ValueError: They are not those of a matrix of numbers or text, a struct, or a cell array.
    """
    if matrix.kind != _MATRIX or depth > _DEEPEST_MAT:
        raise ValueError("damaged: no matrix, or one that is nested too deeply")
    if matrix.begin == matrix.end:
        return
    flags, shape, named, *parts = _elements(content, matrix.begin, matrix.end, order)
    if flags.kind != _UINT32 or flags.end - flags.begin != 8:
        raise ValueError("damaged: a matrix without its class")
    (bits,) = struct.unpack_from(f"{order}I", content, flags.begin)
    kind = bits & 0xFF
    if kind not in (_STRUCT, _CELL, *_NUMERIC):
        last = parts[0] if kind == _OBJECT and parts else named
        words = content[last.begin : last.end].decode("latin-1")
        raise ValueError(only_for_matlab(words if words.isprintable() and words.strip() else "variable of a class"))
    lengths = struct.unpack(f"{order}{(shape.end - shape.begin) // 4}i", content[shape.begin : shape.end])
    if shape.kind != _INT32 or len(lengths) < 2 or min(lengths) < 0:
        raise ValueError("damaged: a matrix without its shape")
    count = prod(lengths)
    if kind == _STRUCT:
        (width,) = struct.unpack_from(f"{order}i", content, parts[0].begin)
        count *= (parts[1].end - parts[1].begin) // width
        parts = parts[2:]
    elif kind in _NUMERIC:
        count = (3 if kind == _SPARSE else 1) + (bits >> 11 & 1)
    if len(parts) != count:
        raise ValueError(f"damaged: {len(parts)} parts of a matrix instead of {count}")
    for part in parts if kind in (_STRUCT, _CELL) else ():
        _check_matrix(content, part, order, depth + 1)
    if kind in _NUMERIC and any(part.kind == _MATRIX for part in parts):
        raise ValueError("damaged: a matrix among numbers")
