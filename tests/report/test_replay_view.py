"""The data of the replay, unpacked as by the page's script."""

import json
import re
from base64 import b64decode
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from stepgap.plants.ticks.tick_table import TickTable
from stepgap.report import RunContext, read_run_folder
from stepgap.report.motion import RATE, DeploymentMotion, Replay, sensed_motion
from stepgap.report.replay_view import LEVELS, MOST_FRAMES, replay_view
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from tests.report.pages import Page, check_alone
from tests.report.runs import make_run, motion, report_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_run(tmp_path_factory.mktemp("replay") / "run", 1)


@pytest.mark.parametrize("frames", [1, 500, 2 * MOST_FRAMES + 1])
def test_channels_are_read_back(folder: Path, frames: int) -> None:
    shown = motion(frames)
    page = replay_view(read_run_folder(folder), Replay({1: shown}, RobotParameters(), 0.4))
    found = re.search(r'id="replay-data">(.*?)</script>', page)
    assert found
    data = json.loads(found[1])
    assert data["leg"] == [0.11, 0.2, 0.045]
    (entry,) = data["motions"]
    every = -(-frames // MOST_FRAMES)
    assert entry["rate"] == RATE / every
    assert entry["frames"] == -(-frames // every)
    packed = np.frombuffer(b64decode(entry["packed"]), "<u2").reshape(6, entry["frames"])
    assert entry["channels"] == [field.name for field in fields(DeploymentMotion)]
    for name, levels, (low, high) in zip(entry["channels"], packed, entry["ranges"], strict=True):
        values = low + (high - low) * levels / LEVELS
        np.testing.assert_allclose(values, getattr(shown, name)[::every], atol=0.51 * (high - low) / LEVELS + 1e-12)
    assert [step[0] for step in entry["steps"]] == list(range(1, 41))


def test_a_page_with_a_replay_stands_alone(folder: Path) -> None:
    replay = Replay({0: motion(300), 1: motion(200)}, RobotParameters(), 0.4)
    page = Page(report_of(folder, RunContext(replay=replay)))
    check_alone(page)
    names = {given.get("id") for _, given in page.tags}
    assert {"replay-canvas", "replay-slider", "replay-play", "replay-deployment", "replay-moment"} <= names


def test_a_sensed_motion_is_read_from_counts() -> None:
    sensors = HopperSensorModel(
        tick=1e-3,
        boom_length=1.5,
        pivot_height=0.4,
        motor_counts=1000,
        boom_counts_horizontal=4000,
        boom_counts_vertical=8000,
        touchdown_force=20,
        takeoff_length=0.28,
    )
    names = ["boom_horizontal", "boom_vertical", "alpha_1", "alpha_2", "contact_force", "step"]
    units: dict[str, str] = dict.fromkeys(names, "")
    ticks = TickTable(units, np.array([[0, 0, 0.1, 0.9, 0, 3], [1000, 8000 / 12, 0.2, 1, 50, 4]]))
    shown = sensed_motion(ticks, sensors)
    np.testing.assert_allclose(shown.travel, [0, 1.5 * np.pi / 2], rtol=1e-6)
    np.testing.assert_allclose(shown.height, [0.4, 0.4 + 1.5 / 2], rtol=1e-6)
    assert shown.step.tolist() == [3, 4]
    assert shown.force.tolist() == [0, 50]
    with pytest.raises(ValueError, match="finite"):
        sensed_motion(TickTable(units, np.full((1, 6), np.nan)), sensors)


@pytest.mark.parametrize("bad", [np.array([1.0, np.nan]), np.zeros(3), np.zeros((2, 1))])
def test_a_motion_is_rows_of_numbers_of_equal_length(bad: np.ndarray) -> None:
    with pytest.raises(ValueError, match=r"must be (rows of equal length|finite)"):
        DeploymentMotion(np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), np.zeros(2), bad)
