"""NumPy's .npy and .npz; arrays of objects, which would have to be unpickled, are refused."""

from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import numpy as np

from stepgap.logs.tables.arrays import tables_of_arrays
from stepgap.logs.tables.files import content_of, leaving_out, reading
from stepgap.logs.tables.log_table import MOST_NUMBERS, LogTable, check_size
from stepgap.records.steps_csv import RecordError

NPY_MAGIC = b"\x93NUMPY"

_LARGEST_ARRAY_FILE = 16 * MOST_NUMBERS  # Largest file or member of an archive that is read [bytes]


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
        if sum(entry.file_size for entry in entries) > _LARGEST_ARRAY_FILE:
            raise RecordError(f"{path}: larger than {_LARGEST_ARRAY_FILE} bytes when decompressed, so it is not read")
        for entry in entries:
            name = entry.filename.removesuffix(".npy")
            with leaving_out(name, unread), archive.open(entry) as file:
                arrays.append(("", name, _array(file.read(entry.file_size), f"{path}, {name}")))
        return tables_of_arrays(str(path), arrays, unread)


def _array(content: bytes, source: str) -> Any:
    """The array, after a check of its type and of its size against the content."""
    stream = BytesIO(content)
    version = np.lib.format.read_magic(stream)
    read_header = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read_header is None:
        raise ValueError(f"version {version} of the NumPy format is not read; 1.0 and 2.0 are")
    shape, _, dtype = read_header(stream)
    if dtype.hasobject:
        raise ValueError("an array of Python objects, which is not unpickled; save numbers")
    count = float(np.prod(shape, dtype=float))
    check_size(source, count)
    if count * dtype.itemsize > len(content) - stream.tell():
        raise ValueError(f"truncated; the header declares the shape {shape}")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)
