"""Files of formats that are not read: what they are, and what to do."""

import re
import zlib
from collections.abc import Sequence
from pathlib import PurePath
from typing import Final

_FORMATS: Final = (
    (b"ULog\x01\x12\x35", "a ULog of PX4; `ulog2csv FILE` of pyulog writes its topics as CSV"),
    (b"\xa3\x95\x80", "a log of ArduPilot; `mavlogdump.py --format csv FILE` of pymavlink writes it as CSV"),
    (b"TDSm", "a TDMS file of LabVIEW; save it as CSV, or as HDF5 by npTDMS"),
    (b"MDF     ", "an MDF file of measurements; save it as CSV or MAT, such as by asammdf"),
    (b"UnFinMF ", "an MDF file that was not finished; let its recorder repair it, and save it as CSV or MAT"),
    (b"LOGG\x90\0\0\0", "a BLF file of CAN frames; save its decoded signals as CSV or MAT"),
    (b"FEA1", "a Feather file of version 1; write it anew by pyarrow or pandas, which write version 2"),
    (b"\xff\xff\xff\xff", "perhaps a stream of Arrow; write it as a Parquet or Feather file"),
    (b"PARE", "an encrypted Parquet file; write it without encryption"),
    (b"\xfd7zXZ\0", "compressed by xz; unpack it by `unxz` before"),
    (b"\x04\x22\x4d\x18", "compressed by lz4; unpack it by `unlz4` before"),
    (b"7z\xbc\xaf\x27\x1c", "an archive of 7-Zip; unpack it before"),
    (b"Rar!\x1a\x07", "an archive of RAR; unpack it before"),
    (b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1", "a workbook of Excel; save it as CSV"),
    (b"# Created by Octave", "a text file of Octave; save it by `save -v7`"),
    *(
        (bytes([0x80, version]), "a pickle, which may run code; save numbers as CSV, .npz or Parquet")
        for version in range(2, 6)
    ),
)
"""First bytes of formats, each with what it is, and what to do."""

_BINARY: Final = (
    (b"\x89MCAP0\r\n", "an MCAP file"),
    (b"#ROSBAG V", "a ROS 1 bag"),
    (b"SQLite format 3\0", "a ROS 2 bag"),
    (b"PAR1", "a Parquet file"),
    (b"ARROW1\0\0", "a Feather file"),
    (b"\x93NUMPY", "a NumPy file"),
    (b"PK\x03\x04", "an archive of zip"),
    (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
    (b"MATLAB ", "a MAT file"),
    (b"ULog\x01\x12\x35", "a ULog of PX4"),
)
"""First bytes of formats that are not read within a file of gzip."""


def kind_of_other(begin: bytes) -> str:
    """What a file with these first bytes is, which is not read, and what to do; empty if it is not known."""
    for magic, kind in _FORMATS:
        if begin.startswith(magic):
            return kind
    if begin[4:10] == b"1AY&SY":
        return "compressed by bzip2; unpack it by `bunzip2` before"
    if begin[257:262] == b"ustar":
        return "an archive of tar; unpack it by `tar -xf` before"
    if re.match(rb"\s*\[\s*[{\[]", begin):
        return "an array in JSON; write one object a line (pandas: orient='records', lines=True)"
    if re.match(rb"\s*\(\d+\.\d+\) \w+ [0-9A-F]+#|\s*\w+ +[0-9A-F]+ +\[\d+\] |date .*\r?\nbase (hex|dec)", begin):
        return "a log of CAN frames; decode them by the file that describes them (.dbc), and save the signals as CSV"
    if re.match(rb"\s*<(!doctype html|html|\?xml)", begin, re.IGNORECASE):
        return "a web page or XML, such as a page about the log; get the file itself"
    return _kind_in_gzip(begin) if begin.startswith(b"\x1f\x8b") else ""


def _kind_in_gzip(begin: bytes) -> str:
    try:
        inner = zlib.decompressobj(wbits=31).decompress(begin, 1024)
    except zlib.error:
        return ""
    kind = next((kind for magic, kind in _BINARY if inner.startswith(magic)), "")
    if inner[257:262] == b"ustar":
        kind = "an archive of tar"
    return f"{kind} compressed by gzip; unpack it by `gunzip` before" if kind else ""


def kind_of_archive(names: Sequence[str]) -> str:
    """What an archive of zip with these members is, which has no arrays, and what to do."""
    if "[Content_Types].xml" in names:
        return "a workbook of Excel; save it as CSV"
    if "mimetype" in names:
        return "a document of LibreOffice; save it as CSV"
    if any(PurePath(name).name == "data.pkl" for name in names):
        return "a file of PyTorch, which may run code; save its tensors by numpy.savez"
    files = [name for name in names if not name.endswith("/")]
    shown = ", ".join(PurePath(name).name for name in files[:3])
    return f"an archive of {len(files)} files, such as {shown:.100}; unpack it by `unzip` before"
