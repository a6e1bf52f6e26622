"""The data for the page agree with the files and the ticks of the run."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.replay import replay
from stepgap.experiment.run import Run
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.scene import Motion
from stepgap.view.source import STILL, Source
from tests.rig_ticks import LOG_UNITS, rig_rows
from tests.shared_run import STEPS


def point(source: Source, motion: Motion, name: str) -> np.ndarray:
    """Positions of a point; shape (F, 3)."""
    assert source.kinematics
    return motion.positions[:, source.kinematics.scene.index(name)]


@pytest.fixture
def copy(run_folder: Path, tmp_path: Path) -> Path:
    return shutil.copytree(run_folder, tmp_path / "run")


def found(source: Source, iteration: int) -> list[Motion]:
    """Waits for all motion of a deployment and returns it."""
    source.want(iteration)
    source.await_motion(iteration)
    motions = [source.motion(iteration, number) for number in range(source.motion_count(iteration))]
    assert all(motions)
    return [motion for motion in motions if motion]


def test_motion_is_that_of_the_replay(run_folder: Path) -> None:
    source, table = Source(run_folder), replay(Run(run_folder), 1, 8)
    hops = found(source, 1)
    assert len(hops) == 1 + STEPS
    assert sum(len(hop.time) for hop in hops) == len(table)
    feet = np.column_stack([table["foot_x"], table["foot_y"], table["foot_z"]])
    drawn = np.concatenate([point(source, hop, "foot") for hop in hops])
    np.testing.assert_allclose(drawn, feet, atol=2e-5)


def test_the_last_moment_of_a_step_is_at_its_apex(run_folder: Path) -> None:
    source = Source(run_folder)
    for hop, logged in zip(found(source, 0)[1:], source.steps(0), strict=True):
        assert point(source, hop, "hip")[hop.frame(1.0), 2] == pytest.approx(logged.record.next_state[1], abs=0.02)


def test_a_ring_gives_the_completed_hops(run_folder: Path) -> None:
    table = replay(Run(run_folder), 1, 8)
    ticks = table.selected(TICK_UNITS).rows
    with TickRing.create(2 + len(TICK_UNITS), 2**12) as ring:
        source = Source(run_folder, ring)
        for step, row in zip(table["step"], ticks, strict=True):
            ring.push((1, step, *row))
        source.poll()
        source.want(1)
        hops = found(source, 1)
    assert [len(hop.time) for hop in hops] == [int(np.sum(table["step"] == step)) for step in range(1 + STEPS)]
    assert source.kinematics
    yaw = source.kinematics.scene.progress(hops[2].positions)
    np.testing.assert_allclose(yaw, table["boom_yaw"][table["step"] == 2], atol=2e-3)


def test_a_rigs_motion_comes_from_its_tick_log(copy: Path) -> None:
    table = replay(Run(copy), 0)
    source = Source(copy)
    source.settings = source.settings.__class__(plant="ethercat", rig="elsewhere.toml")
    with TickLog(copy / "ticks" / "ticks-0.mcap", LOG_UNITS) as log:
        log.append(rig_rows(table.selected(TICK_UNITS).rows, RigState.STEP))
    hops = found(source, 0)
    for step, hop in enumerate(hops):
        time = table["time"][table["step"] == step]
        assert hop.duration == pytest.approx(np.ptp(time), abs=0.02)
    assert len(hops) == 1 + STEPS
    assert source.missing_motion is None
    source.settings = source.settings.__class__(plant="ethercat", rig="elsewhere.toml")
    assert [hop.duration for hop in found(source, 1)] == [STILL] * (1 + STEPS)
    assert source.missing_motion
    assert "ticks-1.mcap" in source.missing_motion.reason


def test_a_changed_record_is_shown_without_motion(copy: Path) -> None:
    lines = (copy / "steps.csv").read_text().splitlines(keepends=True)
    (copy / "steps.csv").write_text(lines[0] + lines[1].replace("0.0", "0.1", 1) + "".join(lines[2:]))
    source = Source(copy)
    hops = found(source, 0)
    assert hops[-1].duration == STILL
    assert source.missing_motion
    assert "could not be reproduced exactly" in source.missing_motion.reason


def test_new_steps_are_read(copy: Path) -> None:
    text = (copy / "steps.csv").read_text()
    lines = text.splitlines(keepends=True)
    (copy / "steps.csv").write_text("".join(lines[:4]) + lines[4][:20])
    source = Source(copy)
    assert len(source.steps(0)) == 2
    assert not source.poll()
    (copy / "steps.csv").write_text(text)
    assert source.poll()
    assert source.iterations == [0, 1]


def test_a_folder_without_a_run_is_refused(tmp_path: Path, copy: Path) -> None:
    with pytest.raises(InputError, match=r"no experiment\.toml"):
        Source(tmp_path / "nothing")
    (copy / "steps.csv").write_text("other,columns\n")
    with pytest.raises(InputError, match="line 1"):
        Source(copy)
    (copy / "steps.csv").unlink()
    with pytest.raises(InputError, match="no step yet"):
        Source(copy)
