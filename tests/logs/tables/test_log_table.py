"""Numbers and times of a column, in all ways in which formats hold them."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from scipy.io import savemat

from stepgap.logs.tables.log_table import LogTable
from stepgap.logs.tables.reading import read_log_table, read_log_tables
from stepgap.records.steps_csv import RecordError


def table(*cells: Any) -> LogTable:
    return LogTable("log", {"t": np.array(cells)})


def test_a_factor_makes_nanoseconds_since_1970_a_time(tmp_path: Path) -> None:
    nanoseconds = [1403638128940097024, 1403638128945096960, 1403638128950097152]
    (tmp_path / "log.csv").write_text("#t [ns],x\n" + "".join(f"{one},0.5\n" for one in nanoseconds))
    found = read_log_table(tmp_path / "log.csv", ["t [ns]"])
    times = found.times("t [ns]", 1e-9)
    np.testing.assert_allclose(times - times[0], [0.0, 4.999936e-3, 10.000128e-3], atol=1e-6)
    with pytest.raises(
        RecordError, match=r"'1.40364e18'; it must be .*\[factors\] of --columns .* 1e-9 for a time in ns"
    ):
        found.times("t [ns]")


@pytest.mark.parametrize(
    ("cells", "seconds"),
    [
        (("2024-02-29T12:00:00", "2024-02-29T12:00:00.123456"), (1709208000.0, 1709208000.123456)),
        (("2024-02-29 12:00:00,5", "2024-02-29 12:00:01.000000000"), (1709208000.5, 1709208001.0)),
        (("2024-02-29T12:00:00+02:00", "2024-02-29T10:00:00Z"), (1709200800.0, 1709200800.0)),
        (("20240229T120000.25", ""), (1709208000.25, np.nan)),
        (("NaN", "10:11:32.332"), (np.nan, 36692.332)),
    ],
)
def test_times_as_text(cells: tuple[str, str], seconds: tuple[float, float]) -> None:
    np.testing.assert_array_equal(table(*cells).times("t"), seconds)


@pytest.mark.parametrize(
    ("cells", "message"),
    [
        (
            ("01/20/2021 10:11:32", "01/20/2021 10:11:33"),
            "row 1, column 't': '01/20/2021 10:11:32'; it must be a number",
        ),
        (("10:11:32", "noon"), "row 2, column 't': 'noon'; it must be a time such as 10:11:32, or empty"),
    ],
)
def test_other_text_is_no_time(cells: tuple[str, str], message: str) -> None:
    with pytest.raises(RecordError, match=message):
        table(*cells).times("t")


def test_numbers_may_be_text_in_any_format(tmp_path: Path) -> None:
    texts = ["0.5", "", "-1e3"]
    (tmp_path / "log.jsonl").write_text("".join(json.dumps({"t": text}) + "\n" for text in texts))
    parquet.write_table(pa.table({"t": texts}), tmp_path / "log.parquet")
    for name in ("log.jsonl", "log.parquet"):
        np.testing.assert_array_equal(read_log_table(tmp_path / name, ["t"]).numbers("t", 2.0), [1.0, np.nan, -2000.0])


def test_times_of_parquet(tmp_path: Path) -> None:
    ends = np.array(["1970-01-01T00:00:01.5", "9999-12-31T00:00:00"], "M8[us]")
    day = [1500, 36692332]
    columns = {
        "spark": pa.array(ends.astype("M8[us]")),
        "ms": pa.array(ends.astype("M8[ms]")),
        "date": pa.array(["1970-01-02", "9999-12-31"]).cast(pa.date32()),
        "day": pa.array(day, pa.int32()).cast(pa.time32("ms")),
        "day_ns": pa.array([one * 1_000_000 + 1 for one in day], pa.int64()).cast(pa.time64("ns")),
        "lasting": pa.array(day, pa.duration("ms")),
    }
    parquet.write_table(pa.table(columns), tmp_path / "log.parquet", use_deprecated_int96_timestamps=False)
    (found,) = read_log_tables(tmp_path / "log.parquet").values()
    last = 253402214400.0
    expected = {"spark": [1.5, last], "ms": [1.5, last], "date": [86400.0, last], "day": [1.5, 36692.332]}
    for name, seconds in (expected | {"day_ns": [1.5, 36692.332], "lasting": [1.5, 36692.332]}).items():
        np.testing.assert_allclose(found.numbers(name), seconds, rtol=1e-8, err_msg=name)


@pytest.mark.parametrize("order", ["<", ">"])
def test_mat_files_of_version_4(order: str, tmp_path: Path) -> None:
    path, values = tmp_path / "log.mat", {"t": np.arange(3.0)[:, None], "x": np.arange(6.0).reshape(3, 2)}
    if order == "<":
        savemat(path, values, format="4")
    else:
        parts = [
            np.array([1000, *one.shape, 0, 2], ">i4").tobytes() + f"{name}\0".encode() + one.astype(">f8").tobytes("F")
            for name, one in values.items()
        ]
        path.write_bytes(b"".join(parts))
    (found,) = read_log_tables(path).values()
    assert {name: found.numbers(name).tolist() for name in found.columns} == {
        "t": [0, 1, 2],
        "x[0]": [0, 2, 4],
        "x[1]": [1, 3, 5],
    }
