"""The data of the replay, unpacked as by the page's script."""

import json
import re
import shutil
import zlib
from base64 import b64decode
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stepgap.experiment.run import Run
from stepgap.records.motion_file import INTERVAL, Replay
from stepgap.report.replay_view import COARSE_LEVELS, LEVELS, MOST_FRAMES, replay_view
from stepgap.robots.scene import GroundPieces
from tests.control.maps import LossyHopper
from tests.report.pages import Page, check_alone
from tests.report.runs import SCENE, motion, report_of


@pytest.mark.parametrize("frames", [1, 500, 2 * MOST_FRAMES + 1])
def test_channels_are_read_back(hopper_run: Path, frames: int) -> None:
    shown = motion(frames)
    page = replay_view(Run(hopper_run, space=LossyHopper().space), Replay({1: shown}, SCENE))
    found = re.search(r'id="replay-data">(.*?)</script>', page)
    assert found
    data = json.loads(found[1])
    assert data["links"] == [[0, 1, 0.01, "near"]]
    assert (data["body"], data["feet"], data["height"], data["circle"]) == (0, [1], 1, 1.5)
    assert [quantity[:2] for quantity in data["state"]] == [["speed", "m/s"], ["height", "m"]]
    (entry,) = data["motions"]
    every = -(-frames // MOST_FRAMES)
    assert entry["frames"] == -(-frames // every)
    if frames > 1:
        assert entry["rate"] == pytest.approx(1 / INTERVAL / every)
    changing = [low < high for low, high, _ in entry["ranges"]]
    bends = np.frombuffer(zlib.decompress(b64decode(entry["packed"])), "<u2").reshape(sum(changing), entry["frames"])
    packed = iter(bends.astype(np.int64).cumsum(axis=1).cumsum(axis=1) % (LEVELS + 1))
    channels = []
    for (low, high, end), changes in zip(entry["ranges"], changing, strict=True):
        levels = next(packed) if changes else 0
        channels.append(np.full(entry["frames"], low) + (high - low) * np.asarray(levels) / end)
    step, *rest = channels
    near = {"rtol": 0, "atol": 1e-4}
    np.testing.assert_allclose(step, shown.step[::every], rtol=0, atol=0.01 + frames / LEVELS / 80)
    body, relative, (touching,) = np.array(rest[:3]).T, np.array(rest[3:9]).T.reshape(-1, 2, 3), rest[9:10]
    np.testing.assert_allclose(relative[:, 0], 0, **near)
    np.testing.assert_allclose(body[:, None] + relative, shown.positions[::every], **near)
    np.testing.assert_allclose(touching, shown.touching[::every, 0], **near)
    half_a_level = 0.501 * np.ptp(shown.signals) / COARSE_LEVELS
    np.testing.assert_allclose(np.array(rest[10:]).T, shown.signals[::every], rtol=0, atol=half_a_level)
    assert data["signals"] == [["leg length", "m"], ["torque", "N·m"]]
    assert [step[0] for step in entry["steps"]] == list(range(1, 41))


def test_a_page_with_a_replay_stands_alone(hopper_run: Path, tmp_path: Path) -> None:
    replay = Replay({0: motion(300), 1: motion(200)}, SCENE)
    page = Page(report_of(shutil.copytree(hopper_run, tmp_path / "run"), replay=replay))
    check_alone(page)
    names = {given.get("id") for _, given in page.tags}
    assert {"replay-canvas", "replay-slider", "replay-play", "replay-deployment", "replay-moment"} <= names


def test_the_legend_speaks_of_what_the_robot_has(hopper_run: Path) -> None:
    run, plain = Run(hopper_run, space=LossyHopper().space), replace(SCENE, feet=(), height="", circle=0.0, signals={})
    motions = {0: motion(40)}
    whole, short = (replay_view(run, Replay(motions, scene)) for scene in (SCENE, plain))
    for words in ("A foot is filled", "Dashed: target height", "Curves: the step", "the bending of the boom"):
        assert words in whole
        assert words not in short
    assert "what they do not contain is not shown." in short


def test_the_ground_is_drawn_and_heights_stand_on_it(hopper_run: Path) -> None:
    run = Run(hopper_run, space=LossyHopper().space)
    start, end, *heights = np.array([[0.0, 1.0], [1.0, 1.5], [0.0, 0.05], [0.01, 0.05]])
    changed = np.array([False, True])
    ground = GroundPieces(start=start, end=end, start_height=heights[0], end_height=heights[1], changed=changed)
    found = re.search(r'id="replay-data">(.*?)</script>', replay_view(run, Replay({1: motion(40)}, SCENE, {1: ground})))
    assert found
    (entry,) = json.loads(found[1])["motions"]
    assert entry["ground"] == [[0, 1, 0, 0.01, 0], [1, 1.5, 0.05, 0.05, 1]]
    assert {step[4] for step in entry["steps"]} == {0}
