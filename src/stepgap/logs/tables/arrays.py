"""Tables from the arrays of binary files, and NumPy's own files, .npy and .npz."""

import warnings
from collections import defaultdict
from collections.abc import Iterable, Iterator, Sequence
from math import prod
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.base.numpy_file import array_in
from stepgap.logs.tables.files import content_of, leaving_out, reading
from stepgap.logs.tables.log_table import MOST_NUMBERS, LogColumn, LogTable, check_size
from stepgap.logs.tables.other_formats import kind_of_archive
from stepgap.records.steps_csv import RecordError

NPY_MAGIC = b"\x93NUMPY"

MOST_COLUMNS = 10_000  # Largest number of columns of one array; wider arrays, such as pictures, are left out
_LARGEST_ARRAY_FILE = 16 * MOST_NUMBERS  # Largest file or member of an archive that is read [bytes]

_TIMES = ("time", "t", "tout", "timestamp", "log_time")
"""Names of vectors of times, in lower case."""

_LONG = 100  # Rows longer than this,
_SLIM = 20  # and than the array is high by this factor, are signals

_AS_STRUCT = {
    "timeseries": "s.time = ts.Time; s.v = ts.Data",
    "timetable": "s.time = seconds(T.Time); s.v = T.v",
    "table": "s = table2struct(T, 'ToScalar', true)",
    "Dataset": "ts = logsout.get(1).Values; s.time = ts.Time; s.v = ts.Data",
}
"""What to save instead of an object of MATLAB, by the last part of its class."""

_PER_SECOND = {"s": 1.0, "ms": 1e3, "us": 1e6, "ns": 1e9, "ps": 1e12}
"""Units of times; those that are longer are whole seconds."""


def tables_of_arrays(
    source: str, arrays: Iterable[tuple[str, str, Any]], unread: dict[str, str]
) -> dict[str, LogTable]:
    """Tables from arrays, each given by group, name and values; the first axis is that of the rows.

    It is the last axis that has as many values as the times of the group, where the first has not, as in MATLAB with a
    signal in a row, or in HDF5 as MATLAB writes it. An array of few and long rows in a file without times has them as
    columns, too, and a `StepGapWarning` says so.

    Arrays of one group that have the same length form a table. Where lengths differ, the number of rows is appended to
    the name of the group. A single number is no column. Arrays of anything but numbers and text are added to `unread`.

    Raises:
        RecordError: The arrays hold too many values.
    """
    groups: dict[tuple[str, int], dict[str, LogColumn]] = defaultdict(dict)
    size = 0
    given = list(arrays)
    rows = _rows_by_group(given)
    for group, name, values in given:
        for column, numbers in columns_of_array(
            name, _with_rows_first(source, name, values, rows.get(group, rows.get(None, 0)))
        ):
            if isinstance(numbers, str):
                unread[part_name(group, column)] = numbers
                continue
            size += len(numbers)
            check_size(source, size)
            groups[group, len(numbers)][column] = numbers
    lengths = defaultdict[str, set[int]](set)
    for group, length in groups:
        lengths[group].add(length)
    named = {
        (group if len(lengths[group]) == 1 else f"{group} ({length} rows)".strip()): columns
        for (group, length), columns in groups.items()
    }
    return {name: LogTable(f"{source}, {name}" if name else source, columns) for name, columns in named.items()}


def _rows_by_group(arrays: Sequence[tuple[str, str, Any]]) -> dict[str | None, int]:
    """Number of rows by group, and under None that of the file: as many as times, or else as the longest vector has."""
    lengths: dict[str | None, tuple[bool, int]] = {}
    for group, name, values in arrays:
        if 1 < values.size == max(values.shape, default=0):
            length = name.rpartition(".")[2].lower() in _TIMES, values.size
            for key in (group, None):
                lengths[key] = max(length, lengths.get(key, (False, 0)))
    return {key: length for key, (_, length) in lengths.items()}


def _with_rows_first(source: str, name: str, values: Any, rows: int) -> Any:
    """An array with the axis of the rows at the beginning; `rows` is their number, 0 if it is not known."""
    if values.ndim < 2 or values.size == max(values.shape):
        return values
    first, *_, last = values.shape
    if rows == last > first:
        return np.moveaxis(values, -1, 0)
    if not rows and values.ndim == 2 and last > _LONG and last > _SLIM * first:
        shown = f"{source}: {name or 'the array'} has {first} rows of {last} values, which are taken as columns"
        warnings.warn(shown, StepGapWarning, stacklevel=2)
        return values.T
    return values


def only_for_matlab(kind: str) -> str:
    """Why an object of a class of MATLAB, such as a table, is left out."""
    advice = _AS_STRUCT.get(kind.rpartition(".")[2], "numbers or a struct")
    return f"a {kind:.40} of MATLAB, which only MATLAB can read; save {advice}"


def part_name(group: str, name: str) -> str:
    """The name of an array as part of a file, GROUP:NAME."""
    return f"{group}:{name}" if group else name


def columns_of_array(name: str, values: Any) -> Iterator[tuple[str, LogColumn | str]]:
    """Yields the columns of an array with their names: NAME, NAME[0], NAME[0][1], or NAME.FIELD.

    Instead of what cannot be a column, it yields the reason.
    """
    if values.dtype.names:
        for field in values.dtype.names:
            yield from columns_of_array(f"{name}.{field}" if name else field, values[field])
        return
    if values.ndim > 1 and values.size == max(values.shape):
        values = values.reshape(-1)
    width = int(np.prod(values.shape[1:], dtype=float))
    if values.ndim == 0 or values.shape == (1,):
        return
    if width > MOST_COLUMNS:
        yield name, f"{width} values in a row; at most {MOST_COLUMNS} become columns"
        return
    for at in np.ndindex(*values.shape[1:]):
        column = numbers_or_labels(values[(slice(None), *at)])
        if column is None:
            yield name, f"values of type {values.dtype}, neither numbers nor text"
            return
        yield name + "".join(f"[{index}]" for index in at), column


def numbers_or_labels(values: Any) -> LogColumn | None:
    """LogColumn as numbers, NaN where one is not finite, or as labels; times in seconds; None for any other type."""
    kind = values.dtype.kind
    if kind in "mM":
        unit, count = np.datetime_data(values.dtype)
        if unit not in _PER_SECOND:
            values = values.astype(f"{kind}8[s]")
            unit = "s"
            count = 1
        return np.where(np.isnat(values), np.nan, values.astype(np.int64) / (_PER_SECOND[unit] / count))
    if kind in "biuf":
        numbers = np.asarray(values, np.float64)
        return np.where(np.isfinite(numbers), numbers, np.nan)
    if kind == "S":
        values = np.char.decode(values, "latin-1")
        kind = "U"
    return np.asarray(values, np.str_) if kind == "U" and values.nbytes <= 4 * MOST_NUMBERS else None


def read_npy(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The columns of a .npy file: its fields, or [0], [1], … of a plain array."""
    content = content_of(path, _LARGEST_ARRAY_FILE)
    with reading(path, "NumPy"):
        return tables_of_arrays(str(path), [("", "", _array(content, str(path)))], unread)


def read_npz(path: Path, unread: dict[str, str]) -> dict[str, LogTable]:
    """The arrays of a .npz file; the members of a dictionary or of a table keep their names.

    Members that cannot be read are added to `unread`, with the reasons.
    """
    arrays: list[tuple[str, str, Any]] = []
    with reading(path, "NumPy .npz"), ZipFile(path) as archive:
        entries = archive.infolist()
        if not any(entry.filename.endswith(".npy") for entry in entries):
            raise RecordError(f"{path}: {kind_of_archive([entry.filename for entry in entries])}")
        if sum(entry.file_size for entry in entries) > _LARGEST_ARRAY_FILE:
            raise RecordError(f"{path}: larger than {_LARGEST_ARRAY_FILE} bytes when decompressed, so it is not read")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            with leaving_out(name, unread), archive.open(entry) as file:
                arrays.append(("", name, _array(file.read(entry.file_size), f"{path}, {name}")))
        return tables_of_arrays(str(path), arrays, unread)


def _array(content: bytes, source: str) -> Any:
    """The array, after a check of its type and of its size against the content."""
    return array_in(content, lambda shape: check_size(source, prod(shape)))
