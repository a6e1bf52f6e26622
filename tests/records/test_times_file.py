"""The file of computing times: what is written is read, and a damaged file is missing with a reason."""

from pathlib import Path

import numpy as np
import pytest

from stepgap.records.missing import Missing
from stepgap.records.times_file import TIMES_FILE, read_times, statistics_of, write_times


def test_times_are_read_as_they_were_written(tmp_path: Path) -> None:
    seconds = np.random.default_rng(0).uniform(0.001, 0.1, 40).tolist()
    planning, fit = statistics_of(seconds), statistics_of([1.5])
    times = {0: {"planning": planning}, 2: {"fit": fit, "planning": planning}}
    write_times(tmp_path, times)
    assert read_times(tmp_path) == times
    assert fit == {"count": 1.0, "total": 1.5, "median": 1.5, "p95": 1.5, "largest": 1.5}
    assert planning["median"] == np.median(seconds)
    assert planning["largest"] == max(seconds)


@pytest.mark.parametrize(
    "text",
    [
        "", "3", "[]", "{}", '{"deployments": 3}', '{"deployments": [3]}', '{"deployments": [{}]}', "[" * 10_000,
        '{"deployments": [{"iteration": 0, "fit": {"count": 1}}]}',
        '{"deployments": [{"iteration": 0, "fit": {"count": 1, "total": "x", "median": 1, "p95": 1, "largest": 1}}]}',
    ],
)  # fmt: skip
def test_a_damaged_file_is_missing(text: str, tmp_path: Path) -> None:
    (tmp_path / TIMES_FILE).write_text(text)
    found = read_times(tmp_path)
    assert isinstance(found, Missing)
    assert "\n" not in found.reason
    assert TIMES_FILE in found.reason
    assert read_times(tmp_path / "nowhere") == Missing("the folder contains no times.json")
