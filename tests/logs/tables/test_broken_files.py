"""Broken and hostile files: each is answered by one line that names the file, never by a traceback or by numbers."""

import bz2
import gzip
import lzma
import os
import struct
import zipfile
import zlib
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from mcap.writer import CompressionType, Writer
from pyarrow import parquet
from scipy.io import savemat

from stepgap.logs.tables.foreign_files import READERS
from stepgap.logs.tables.reading import chosen_table, read_log_tables
from stepgap.records.steps_csv import RecordError
from tests.logs.tables.test_formats import write_bag, write_mat_73, write_mcap_json

WANTED = ("t", "v")


def saved(write: Callable[[Any], object]) -> bytes:
    stream = BytesIO()
    write(stream)
    return stream.getvalue()


def npy(values: Any, **options: Any) -> bytes:
    return saved(lambda file: np.save(file, values, **options))


def npy_header(shape: str, dtype: str = "'<f8'") -> bytes:
    header = f"{{'descr': {dtype}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode()


def npz(**members: bytes) -> bytes:
    def write(file: Any) -> None:
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, content in members.items():
                archive.writestr(f"{name}.npy", content)

    return saved(write)


def archive(*names: str) -> bytes:
    def write(file: Any) -> None:
        with zipfile.ZipFile(file, "w") as packed:
            for name in names:
                packed.writestr(name, "t,v\n0,1\n")

    return saved(write)


def zip_bomb() -> bytes:
    """Two members, together larger than what is read."""
    content = npy_header("(300000,)") + bytes(2_400_000)
    return npz(t=content, v=content)


def mat(compressed: bytes | None = None, **variables: Any) -> bytes:
    content = saved(lambda file: savemat(file, variables))
    if compressed is None:
        return content
    return content[:128] + struct.pack("<II", 15, len(compressed)) + compressed


def mat_with_size(rows: int) -> bytes:
    content = bytearray(mat(t=np.zeros((3, 1))))
    at = content.index(struct.pack("<ii", 3, 1))
    content[at : at + 8] = struct.pack("<ii", rows, 1000)
    return bytes(content)


def mat_with_unknown_type() -> bytes:
    """A struct in which numbers are of a type that there is not; scipy would look it up beyond the end of its table."""
    return mat(log={"t": np.zeros((3, 1))}).replace(struct.pack("<II", 9, 24), struct.pack("<II", 0x8009, 24))


def deflated(size: int) -> bytes:
    packer = zlib.compressobj()
    return b"".join([*(packer.compress(bytes(2**20)) for _ in range(size >> 20)), packer.flush()])


def hdf5(fill: Callable[[Any], object]) -> bytes:
    def write(stream: Any) -> None:
        with h5py.File(stream, "w") as file:
            fill(file)

    return saved(write)


def external_values(file: Any) -> None:
    file.create_dataset("t", (3,), float, external=[("/etc/passwd", 0, 24)])


def virtual_values(file: Any) -> None:
    layout = h5py.VirtualLayout((3,), float)
    layout[:] = h5py.VirtualSource("other.h5", "t", (3,))
    file.create_virtual_dataset("t", layout)


def external_link(file: Any) -> None:
    file["t"] = h5py.ExternalLink("/etc/passwd", "/t")


def cycle(file: Any) -> None:
    group = file.create_group("a")
    group["b"] = group


def table_file() -> bytes:
    return saved(lambda file: parquet.write_table(pa.table({"t": [0.0], "v": [1.0]}), file))


def mcap(
    encoding: str = "json", data: bytes = b"{}", schema: bytes = b"{}", schema_encoding: str = "jsonschema"
) -> bytes:
    def write(file: Any) -> None:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start()
        kind = writer.register_schema("a/msg/A", schema_encoding, schema)
        writer.add_message(writer.register_channel("/a", encoding, kind), 0, data, 0)
        writer.finish()

    return saved(write)


def mcap_bomb() -> bytes:
    import zstandard

    data = zstandard.ZstdCompressor().compress(bytes(2**23))
    body = struct.pack("<QQQI", 0, 0, 2**23, 0) + struct.pack("<I", 4) + b"zstd" + struct.pack("<Q", len(data)) + data
    header = b"\x01" + struct.pack("<QII", 8, 0, 0)
    return b"\x89MCAP0\r\n" + header + b"\x06" + struct.pack("<Q", len(body)) + body


def of_writer(write: Callable[[Path], object], change: Callable[[bytes], bytes]) -> Callable[[Path], None]:
    def write_broken(path: Path) -> None:
        write(path)
        path.write_bytes(change(path.read_bytes()))

    return write_broken


def half(content: bytes) -> bytes:
    return content[: len(content) // 2]


def ros1_bag(path: Path) -> None:
    write_bag(path, "ros1")


def ros1_with_wrong_type(content: bytes) -> bytes:
    return content.replace(b"float64[] position", b"Missing[] position")


def without_index(content: bytes) -> bytes:
    """As a recorder leaves it that was killed."""
    at = content.index(b"index_pos=") + 10
    return content[:at] + bytes(8) + content[at + 8 :]


def folder(path: Path) -> None:
    path.mkdir()


def bag_without_parts(path: Path) -> None:
    path.mkdir()
    (path / "metadata.yaml").write_text("{}")


def pipe(path: Path) -> None:
    os.mkfifo(path)


BROKEN: dict[str, tuple[bytes | Callable[[Path], None], str]] = {
    "empty": (b"", "empty"),
    "blank": (b"\n \n\n", "empty"),
    "only comments": (b"# a\n# b\n", "empty"),
    "no names": (b"0,1\n1,2\n", "line 1: '0,1'; it must be a line of column names"),
    "ragged": (b"t,v\n0,1\n1\n", "line 3: 1 values; it must have 2"),
    "ragged spaces": (b"t v\n0 1\n1 2\n1 2 3\n", "line 4: 3 values; it must have 2"),
    "repeated column": (b"t,v,v\n0,1,2\n", "more than one such column"),
    "mixed decimals": (b"t;v\n0,5;1.5\n", "has a decimal comma, but other numbers have a decimal point"),
    "thousands": (b"t;v\n0;1.234,5\n", "has separated thousands"),
    "thousands or decimal": (b"t;v\n0;1,234\n", "may be a decimal comma or separate thousands"),
    "comma or decimal": (b"t\n0,5\n1,5\n", "may separate columns or be a decimal comma"),
    "decimal commas in commas": (b"t,v\n0,5,1,5\n", "4 values; it must have 2, as the header; a decimal comma needs"),
    "two separators": (b"t,a;v\n1,2;3\n", "the rows do not show which separates the columns"),
    "too large": (b"t,v\n0,1e400\n", "column 'v': 'inf'; it must be a number within"),
    "words": (b"t,v\n0,fast\n", "column 'v': 'fast'; it must be a number within"),
    "underscore": (b"t,v\n0,1_000\n", "column 'v': '1_000'; it must be a number within"),
    "unclosed quote": (b't,v\n0,"1\n', "line 2: unexpected end of data"),
    "NUL": (b"t,v\n0,\x001\n", "not a text file"),
    "UTF-16 without its mark": ("t,v\n0,1\n".encode("utf-16-le"), "not a text file"),
    "odd UTF-16": (b"\xff\xfet\x00\x00\xd8,\x00", "not a text file in utf-16"),
    "picture": (b"\x89PNG\r\n\x1a\n" + bytes(100), "not a text file"),
    "truncated gzip": (gzip.compress(b"t,v\n" + os.urandom(99))[:12], "truncated gzip file"),
    "wrong gzip": (b"\x1f\x8b\x08" + bytes(60), "gzip file"),
    "gzip bomb": (gzip.compress(bytes(2**22 + 1), 1), "larger than 4194304 bytes"),
    "binary in gzip": (gzip.compress(npy(np.zeros(3))), "a NumPy file compressed by gzip; unpack it by `gunzip`"),
    "text in zip": (archive("log.csv"), "an archive of 1 files, such as log.csv; unpack it by `unzip` before"),
    "Excel": (archive("[Content_Types].xml", "xl/workbook.xml"), "a workbook of Excel; save it as CSV"),
    "ULog": (b"ULog\x01\x12\x35" + bytes(99), "a ULog of PX4; `ulog2csv FILE` of pyulog"),
    "TDMS": (b"TDSm" + bytes(99), "a TDMS file of LabVIEW"),
    "xz": (lzma.compress(b"t,v\n0,1\n"), "compressed by xz; unpack it by `unxz` before"),
    "bzip2": (bz2.compress(b"t,v\n0,1\n"), "compressed by bzip2"),
    "array in JSON": (b'[{"t": 0, "v": 1}]', "an array in JSON; write one object a line"),
    "candump": (b"(1735270496.916858) can0 110#00112233\n" * 3, "a log of CAN frames; decode them by the file"),
    "CAN in a terminal": (b"  can0  110   [2]  00 11\n" * 3, "a log of CAN frames"),
    "PyTorch": (archive("archive/data.pkl"), "a file of PyTorch, which may run code"),
    "web page": (b"<!DOCTYPE html>\n<html>", "a web page or XML"),
    "Octave": (b"# Created by Octave 8.4.0, now <a@b>\n# name: t\n# type: scalar\n1\n", "a text file of Octave"),
    "ROS 1 bag without an index": (of_writer(ros1_bag, without_index), "rosbag reindex"),
    "JSON array": (b'{"t": 0, "v": 1}\n[1, 2]\n', "line 2: not an object"),
    "truncated JSON": (b'{"t": 0, "v"', "line 1: "),
    "wrong JSON": (b'{"t": 0, "v": 1}\n{"t": 0, "v"\n', "line 2: "),
    "key twice": (b'{"t": 0, "v": 1, "v": 2}\n', "line 1: a key occurs twice"),
    "deep JSON": (b'{"t":' + b"[" * 200_000, "line 1: "),
    "huge JSON number": (b'{"t": 0, "v": 1e400}\n', "line 1, column 'v': 'inf'"),
    "many keys": (b"".join(b'{"k%d": 0}\n' % i for i in range(1100)), "values, rows times columns"),
    "pickle in npy": (npy(np.array([{}, None], object), allow_pickle=True), "not unpickled"),
    "pickle in npz": (npz(t=npy(np.array([{}], object), allow_pickle=True)), "not unpickled"),
    "pickle": (b"\x80\x04\x95" + bytes(40), "a pickle, which may run code"),
    "lying npy": (npy_header("(1000,)") + bytes(8), "truncated; the header declares the shape (1000,)"),
    "huge npy": (npy_header("(10000000000000,)") + bytes(8), "1e+13 values, rows times columns"),
    "negative npy": (npy_header("(-5,)") + bytes(8), "log: "),
    "code in npy": (npy_header("__import__('os').getpid()"), "not a readable NumPy file"),
    "truncated npz": (half(npz(t=npy(np.zeros(300)))), "not a readable NumPy .npz file"),
    "zip bomb": (zip_bomb(), "when decompressed, so it is not read"),
    "truncated MAT": (half(mat(t=np.zeros(300))), "truncated MAT file"),
    "huge MAT": (mat_with_size(10**9), "1e+12 values, rows times columns"),
    "lying MAT": (mat_with_size(2), "nothing in it can be read: t ("),
    "unknown type in MAT": (
        mat_with_unknown_type(),
        "variable 1 (damaged: an element of a type or length that there is",
    ),
    "MAT bomb": (mat(deflated(2**23), t=0.0), "when decompressed"),
    "damaged MAT": (mat(b"not deflated", t=0.0), "nothing in it can be read: variable 1 (Error -3 while"),
    "truncated MAT 7.3": (of_writer(write_mat_73, half), "not a readable HDF5 file"),
    "truncated HDF5": (half(hdf5(lambda file: file.create_dataset("t", data=np.zeros(999)))), "not a readable HDF5"),
    "huge HDF5": (hdf5(lambda file: file.create_dataset("t", (10**10,), float, chunks=(10**4,))), "1e+10 values"),
    "external link": (hdf5(external_link), "a link to another file, which is not followed"),
    "external values": (hdf5(external_values), "its values lie in another file"),
    "virtual values": (hdf5(virtual_values), "its values lie in another file"),
    "cycle in HDF5": (hdf5(cycle), "no table of numbers in this file"),
    "long texts in HDF5": (
        hdf5(lambda file: file.create_dataset("t", (10,), "S1000000", chunks=(1,))),
        "1.25e+06 values, rows times columns",
    ),
    "wide parts in HDF5": (
        hdf5(lambda file: file.create_dataset("t", (9,), float, maxshape=(None,), chunks=(2**20,))),
        "parts larger than 4194304 bytes",
    ),
    "many objects in HDF5": (
        hdf5(lambda file: [file.create_group(str(number)) for number in range(101)]),
        "more than 100 objects",
    ),
    "deep HDF5": (hdf5(lambda file: file.create_group("a/" * 300)), "nested groups"),
    "truncated Parquet": (half(table_file()), "not a readable Parquet file"),
    "damaged Parquet": (table_file()[:-8] + b"\xff\xff\xff\x7fPAR1", "not a readable Parquet file"),
    "unknown encoding": (mcap("flatbuffer"), "nothing in it can be read: /a (messages in 'flatbuffer', not read"),
    "truncated MCAP": (of_writer(write_mcap_json, lambda content: content[:300]), "not a readable MCAP file"),
    "no JSON in MCAP": (mcap(data=b"\xff"), "nothing in it can be read: /a ('utf-8' codec can't decode"),
    "wrong protobuf": (mcap("protobuf", b"a", b"zzz", "protobuf"), "/a (the definition of a/msg/A cannot be read)"),
    "truncated CDR": (mcap("cdr", b"\0\1\0\0\1", b"float64 x", "ros2msg"), "/a (a message that is shorter than its"),
    "lying CDR": (
        mcap("cdr", b"\0\1\0\0" + b"\xff" * 4, b"float64[] x", "ros2msg"),
        "/a (a message that is shorter than its",
    ),
    "MCAP bomb": (mcap_bomb(), "when decompressed"),
    "truncated ROS 1 bag": (of_writer(ros1_bag, half), "not a readable ROS 1 bag file"),
    "wrong ROS 1 type": (
        of_writer(ros1_bag, ros1_with_wrong_type),
        "/joints (no definition of a/msg/Missing in the log)",
    ),
    "wrong SQLite": (b"SQLite format 3\0" + bytes(99), "not a readable ROS 2 bag"),
    "bag without parts": (bag_without_parts, "a ROS 2 bag must have .mcap or .db3 files, not both"),
    "folder": (folder, "Is a directory"),
    "pipe": (pipe, "not a file"),
}


@pytest.fixture(autouse=True)
def _small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """So that bombs need not be large."""
    for limit in (
        "matlab._LARGEST_MAT",
        "arrays._LARGEST_ARRAY_FILE",
        "files.LARGEST_PART",
        "hdf5.LARGEST_PART",
        "reading.LARGEST_LOG",
    ):
        monkeypatch.setattr(f"stepgap.logs.tables.{limit}", 2**22)
    monkeypatch.setattr("stepgap.logs.tables.log_table.MOST_NUMBERS", 10**6)
    monkeypatch.setattr("stepgap.logs.tables.hdf5._MOST_OBJECTS", 100)


LIMITED = {
    "huge MAT": "MAT",
    "MAT bomb": "MAT",
    "huge HDF5": "HDF5",
    "long texts in HDF5": "HDF5",
    "wide parts in HDF5": "HDF5",
    "many objects in HDF5": "HDF5",
}
"""Kinds of the files that are read here instead of in another process, which would not have the small limits."""


def read_numbers(name: str, path: Path) -> None:
    unread = dict[str, str]()
    tables = READERS[LIMITED[name]](path, unread) if name in LIMITED else read_log_tables(path)
    if unread and not tables:
        raise RecordError(f"{path}: {unread}")
    table = chosen_table(path, tables, WANTED)
    for column in WANTED:
        table.numbers(column)


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_answered_by_one_line(name: str, tmp_path: Path) -> None:
    content, message = BROKEN[name]
    path = tmp_path / "log"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        content(path)
    with pytest.raises(RecordError) as caught:
        read_numbers(name, path)
    line = str(caught.value)
    assert message in line
    assert line.startswith(str(path))
    assert "\n" not in line
    assert len(line) < 500 + len(str(path))
