"""Sentences on a run claim no more than its numbers support."""

import json
from pathlib import Path
from typing import Any

import pytest

from stepgap.records.run_folder import RunRecord, read_run_folder
from stepgap.report.sentences import headline, sentences
from tests.report.runs import make_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("sentences") / "run")


def changed(run: Path, floor: float, **last: Any) -> RunRecord:
    """The run with a noise floor and with other values of its last deployment."""
    content = json.loads((run / "summary.json").read_text())
    content["repeatability"] = dict.fromkeys(("speed", "height"), floor)
    content["iterations"][-1] |= last
    (run / "summary.json").write_text(json.dumps(content))
    return read_run_folder(run)


def test_an_error_above_three_noise_floors_is_not_called_tracking(run: Path) -> None:
    small = {"speed": 0.001, "height": 0.001}
    assert headline(changed(run, 0.001, rmse=small)).startswith("It tracked: the last deployment made all its")
    large = small | {"height": 0.0031}
    found = headline(changed(run, 0.001, rmse=large))
    assert found.startswith("It did not track: the error of height is 3.1 noise floors. But the last deployment")
    assert headline(changed(run, 0.0, rmse=large)).startswith("It tracked"), "an unknown noise floor claims nothing"


def test_cut_commands_and_targets_that_were_not_held_are_listed(run: Path) -> None:
    text = " ".join(sentences(changed(run, 0.001, cut=7, unreachable=[[0.3, 0.7]], missed=[[0.1, 0.6]] * 8), "twin"))
    assert "Limits cut 7 of 40 commands of deployment 2" in text
    assert "Unreachable according to the map of deployment 2: 1 target (0.3 m/s 0.7 m)." in text
    assert "Unreachable according to the nominal map" not in text
    assert "although reachable according to the map: 8 targets (0.1 m/s 0.6 m; " in text
    assert "; and 2 more)" in text
    text = " ".join(sentences(changed(run, 0.001, cut=0, unreachable=[], missed=[]), "twin"))
    assert not any(word in text for word in ("cut", "Unreachable", "Missed"))
