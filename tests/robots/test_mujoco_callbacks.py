"""Tests of MuJoCo's global callbacks."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from collections.abc import Iterator
from itertools import count
from pathlib import Path

import mujoco
import pytest

from stepgap.robots.mujoco_callbacks import set_mujoco_callbacks

PENDULUM = "<mujoco><worldbody><body><joint axis='0 1 0'/><geom size='.1' pos='1 0 0'/></body></worldbody></mujoco>"


@pytest.fixture(autouse=True)
def stepgap_callbacks() -> Iterator[None]:
    yield
    mujoco.set_mjcb_time(None)  # this gives back the clock of MuJoCo's Python package
    set_mujoco_callbacks()


def stepped() -> mujoco.MjData:
    """Data of a pendulum after a step."""
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data)
    return data


def test_stages_of_a_step_are_not_timed():
    mujoco.set_mjcb_time(None)
    timed = stepped()
    set_mujoco_callbacks()
    untimed = stepped()
    assert timed.timer[mujoco.mjtTimer.mjTIMER_STEP].duration > 0
    assert untimed.timer[mujoco.mjtTimer.mjTIMER_STEP].duration == 0
    assert untimed.timer[mujoco.mjtTimer.mjTIMER_STEP].number == 1
    assert timed.qvel[0] == untimed.qvel[0] != 0


def test_a_clock_of_the_caller_is_kept():
    clock = count()
    mujoco.set_mjcb_time(lambda: next(clock))
    set_mujoco_callbacks()
    assert stepped().timer[mujoco.mjtTimer.mjTIMER_STEP].duration > 0


def test_an_unstable_simulation_writes_no_log_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    set_mujoco_callbacks()
    model = mujoco.MjModel.from_xml_string(PENDULUM)
    data = mujoco.MjData(model)
    data.qvel[0] = 1e12
    mujoco.mj_step(model, data)
    assert data.warning[mujoco.mjtWarning.mjWARN_BADQVEL].number == 1
    assert not list(tmp_path.iterdir())
