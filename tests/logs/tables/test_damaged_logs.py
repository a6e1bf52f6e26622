"""Logs that ended badly, and files that end their reader: what is whole is read, and one line says what is not."""

import gzip
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather

from stepgap.base.errors import StepGapWarning
from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_tables
from stepgap.records.steps_csv import RecordError

WHOLE = b"t,v\n" + b"".join(b"%.2f,%.3f\n" % (at / 100, at / 8) for at in range(200))
CUT = WHOLE[:-8]  # in the middle of the last line


def read(content: bytes, folder: Path, message: str = "") -> LogTable:
    """The table of a log, which is read with a warning that contains the message."""
    path = folder / "log"
    path.write_bytes(content)
    if not message:
        return read_log_tables(path)[""]
    with pytest.warns(StepGapWarning) as caught:
        tables = read_log_tables(path)
    assert message in " | ".join(str(one.message) for one in caught)
    return tables[""]


@pytest.mark.parametrize(
    ("content", "rows", "message"),
    [
        (CUT, 199, "log, line 201: left out, because the log ends in the middle of it: 1.99"),
        (WHOLE[:-3], 199, "line 201: left out, because the log ends in the middle of it: 1.99, 24.8"),
        (WHOLE[:-1], 200, ""),
        (b"t,v\n0,10\n1,20\n2,5", 3, ""),
        (CUT.replace(b",", b" "), 199, "line 201: left out, because"),
        (CUT.replace(b",", b";").replace(b".", b","), 199, "line 201: left out, because"),
        (CUT.replace(b"\n", b"\r\n"), 199, "line 201: left out, because"),
        (WHOLE + bytes(4096), 200, "line 202: left out 4096 zero bytes at the end of the file"),
        (CUT + bytes(4096), 199, "line 201: left out, because the log ends in the middle of it"),
        (CUT + b"\xff" * 4096, 199, "line 201: left out, because the log ends in the middle of it"),
        (WHOLE.replace(b"\n1.00,", b"\n1.0" + bytes(9)), 199, "line 102: left out, with zero bytes in it"),
        ("é,t,v\né,0,1\né,1,2\né".encode()[:-1], 2, ""),
        (b't,note\n0,"a"\n1,"b', 1, "line 3: left out, because the log ends in the middle of it"),
        (b'{"t": 0, "v": 1}\n{"t": 1, "v', 1, "line 2: left out, because the log ends in the middle of it"),
        (gzip.compress(WHOLE, 0)[:-900], 125, "truncated"),
        (b"t,v\n" + WHOLE[4:].replace(b"\n", b",\n"), 200, ""),
        (b"t,v,\n" + WHOLE[4:], 200, ""),
        (b"t,v\n" + WHOLE[4:].replace(b"\n", b",,\n"), 200, ""),
        (b"t (s, GPS);v\n" + WHOLE[4:].replace(b",", b";").replace(b"\n", b";\n"), 200, ""),
    ],
)  # fmt: skip
def test_rows_before_a_bad_end_are_read(content: bytes, rows: int, message: str, tmp_path: Path) -> None:
    """A number of rows that was cut off is at most the last one, so the others are right."""
    table = read(content, tmp_path, message)
    assert len(table) == rows
    if "v" in table.columns and rows > 100:
        np.testing.assert_array_equal(table.numbers("v")[:100], np.round(np.arange(100) / 8, 3))


@pytest.mark.parametrize("content", [b"t,v\n0,1\n1\n2,3", b"t,v\n0,1\n1\n", b"t,v\n0,1\n1,2,3"])
def test_a_row_that_does_not_fit_is_not_the_end_of_a_log(content: bytes, tmp_path: Path) -> None:
    (tmp_path / "log").write_bytes(content)
    with pytest.raises(RecordError, match=r"line 3: [13] values; it must have 2, as the header"):
        read_log_tables(tmp_path / "log")


def test_a_feather_file(tmp_path: Path) -> None:
    names: Any = pa.array([["a", "b"]] * 3)
    feather.write_feather(pa.table({"t": [0.0, 1.0, 2.0], "names": names}), str(tmp_path / "log"))
    table = read_log_tables(tmp_path / "log")[""]
    assert table.numbers("t").tolist() == [0.0, 1.0, 2.0]
    assert table.columns["names[1]"].tolist() == ["b"] * 3


def damaged_text(path: Path) -> None:
    """A text whose length in the file is 4 GB."""
    with h5py.File(path, "w") as file:
        file.create_dataset("s", data=["a" * 123], dtype=h5py.string_dtype())
    content = path.read_bytes()
    length = (123).to_bytes(4, "little")
    assert length in content
    path.write_bytes(content.replace(length, b"\x00\xff\xff\xff"))


def test_a_damaged_length_takes_no_memory_here(tmp_path: Path) -> None:
    damaged_text(tmp_path / "log")
    with pytest.raises(RecordError, match="nothing in it can be read: s"):
        read_log_tables(tmp_path / "log")


ENDING = """
import os, sys
sys.modules["h5py"] = type("h5py", (), {"__getattr__": lambda *_: os.abort()})()
"""


def test_a_library_that_aborts_ends_its_process_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As pyarrow does for some damaged footers."""
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(ENDING)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"))
    with h5py.File(tmp_path / "log", "w") as file:
        file["t"] = [0.0, 1.0]
    with pytest.raises(RecordError, match=r"log: not a readable HDF5 file, damaged or incomplete \(its library ends"):
        read_log_tables(tmp_path / "log")
