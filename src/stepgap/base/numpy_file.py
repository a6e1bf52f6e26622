"""Files of NumPy from others, `.npy` and `.npz`: what they claim to hold is checked before memory is taken for it."""

from collections.abc import Callable
from io import BytesIO
from math import prod
from typing import Any
from zipfile import ZIP_DEFLATED, ZIP_STORED, ZipFile

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError

MOST_MEMBERS = 1000
"""Largest number of arrays of a `.npz`; the directory alone of a file with millions of empty ones fills the memory."""

_MEMBER = b"PK\x01\x02"  # Each entry of the directory of a ZIP archive begins so


def array_in(content: bytes, check_shape: Callable[[tuple[int, ...]], None] = lambda _: None) -> NDArray[Any]:
    """The array in a `.npy` file; its header must not claim more than the file holds.

    Args:
        check_shape: Raises an error where the array has too many values.

    Raises:
        ValueError: The content is not such an array, or one of Python objects, which is not unpickled.
    """
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
    check_shape(shape)
    if prod(shape) * dtype.itemsize > len(content) - stream.tell():
        raise ValueError(f"truncated; the header declares the shape {shape}")
    stream.seek(0)
    return np.lib.format.read_array(stream, allow_pickle=False)


def arrays_in(content: bytes, largest: int) -> dict[str, NDArray[Any]]:
    """The arrays in a `.npz` file, by name; `largest` is the largest size of all together [bytes].

    Raises:
        InputError: The content is not such a file, or its arrays are larger; the message does not name the file.
    """
    try:
        if content.count(_MEMBER) > MOST_MEMBERS:
            raise ValueError(f"more than {MOST_MEMBERS} arrays")
        with ZipFile(BytesIO(content)) as archive:
            entries = archive.infolist()
            if sum(entry.file_size for entry in entries) > largest:
                raise ValueError(f"larger than {largest} bytes when decompressed")
            if {entry.compress_type for entry in entries} - {ZIP_STORED, ZIP_DEFLATED}:
                raise ValueError("compressed as NumPy does not")  # other methods do not bound what they decompress
            return {entry.filename.removesuffix(".npy"): array_in(archive.read(entry)) for entry in entries}
    except Exception as error:  # damaged archives and headers raise exceptions of a dozen types
        raise InputError(f"not a .npz file of arrays ({' '.join(str(error).split())[:120]})") from None
