"""Signals of logs: several files, several rates, missing values; wrong times and names are refused by one line."""

from pathlib import Path

import numpy as np
import pytest

from stepgap.logs.sections.signals import SignalLog, read_deployments, read_signal_log
from stepgap.logs.tables.text import AS_FOUND
from stepgap.records.steps_csv import RecordError


@pytest.fixture(autouse=True)
def _in_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def read(text: str, time: str = "", **factors: float) -> SignalLog:
    return read_signal_log(text, time, factors)


def test_files_have_their_own_times_or_those_of_the_first() -> None:
    Path("body.csv").write_text("t,y\n0,1\n0.1,2\n0.2,\n0.3,4\n")
    Path("slow.csv").write_text("t,x\n0.05,10\n0.25,20\n")
    Path("same.csv").write_text("z,phase\n5,A\n6,A\n7,B\n8,\n")
    log = read("body.csv+slow.csv+same.csv", x=0.001)
    for column, time, values in (
        ("y", [0, 0.1, 0.3], [1, 2, 4]), ("x", [0.05, 0.25], [0.01, 0.02]), ("z", [0, 0.1, 0.2, 0.3], [5, 6, 7, 8]),
    ):  # fmt: skip
        np.testing.assert_allclose(log.signal(column).time, time)
        assert log.signal(column).values.tolist() == values
    assert log.labels("phase").values.tolist() == ["A", "A", "B"]
    assert log.columns == ["t", "y", "x", "z", "phase"]
    assert log.signal("y").between(0.1, 0.3).values.tolist() == [2, 4]


def test_numbers_may_be_labels() -> None:
    Path("log.csv").write_text("time,phase\n0,1234567\n1,1234568\n2,2.5\n")
    assert read("log.csv").labels("phase").values.tolist() == ["1234567", "1234568", "2.5"]


def test_a_column_divides_a_log_into_deployments() -> None:
    """Their times begin anew; a table with as many rows is divided, too; one that is wrong is no fault of others."""
    Path("log.csv").write_text("t,trial,y\n0,b,1\n1,b,2\n0,10,3\n2,10,4\n1,10,5\n5,,6\n0,2,7\n3,2,8\n")
    Path("same.csv").write_text("z\n" + "".join(f"{row}\n" for row in range(8)))
    b, ten, two = read_deployments("log.csv+same.csv", "", {}, AS_FOUND, "trial")
    assert (b().deployment, two().deployment) == ("b", "2")
    assert [log.signal(name).values.tolist() for log in (b(), two()) for name in "yz"] == [
        [1, 2],
        [0, 1],
        [7, 8],
        [6, 7],
    ]
    with pytest.raises(RecordError, match=r"log.csv, line 6, column 't': the time goes back"):
        ten()
    Path("other.csv").write_text("t,x\n0,1\n")
    with pytest.raises(RecordError, match=r"other.csv: no column 'trial'; there is t, x; it is to be the deployment"):
        read_deployments("log.csv+other.csv", "", {}, AS_FOUND, "trial")


def test_a_file_with_a_plus_in_its_name_is_one_file() -> None:
    Path("a+b.csv").write_text("time,y\n0,1\n1,2\n")
    assert len(read("a+b.csv").signal("y")) == 2


@pytest.mark.parametrize(
    ("content", "text", "column", "message"),
    [
        ("a,y\n0,1\n", "log.csv", "y", "log.csv: no column of the time, named time, log_time, t, timestamp"),
        (
            "t,y\n0,1\n2,1\n1,1\n",
            "log.csv",
            "y",
            "log.csv, line 4, column 't': the time goes back from 2.000000 to 1.000000 s",
        ),
        ("t,y\n0,1\n1,1\n", "log.csv", "z", "log.csv: no column 'z'; there is t, y"),
        ("t,y\n0,1\n1,\n", "log.csv", "y", "log.csv, column 'y': 1 numbers; at least 2 are needed"),
        ("t,y\n0,1\n1,1\n", "log.csv+three.csv", "z", "three.csv: no column of the time, named time, log_time, t, "),
        ("t,y\n0,1\n1,1\n", "log.csv+three.csv", "z", ", and not the 2 rows of the first file"),
        ("t,y\n0,1\n1,1\n", "log.csv+gone.csv", "y", "gone.csv: No such file or directory"),
        ("t,y\n0,1\n1,high\n", "log.csv", "y", "log.csv, line 3, column 'y': 'high'; it must be a number"),
    ],
)
def test_what_is_wrong_is_said(content: str, text: str, column: str, message: str) -> None:
    Path("log.csv").write_text(content)
    Path("three.csv").write_text("z\n1\n2\n3\n")
    with pytest.raises(RecordError) as refusal:
        read(text).signal(column)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)
