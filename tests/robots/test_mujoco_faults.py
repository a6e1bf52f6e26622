"""What MuJoCo mends without a word is found, with its joint or actuator, its time and a remedy."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from typing import Any

import mujoco
import numpy as np
import pytest

from stepgap.robots.mujoco_callbacks import set_mujoco_callbacks
from stepgap.robots.mujoco_faults import keep_divergence, mujoco_fault

ARM = """
<mujoco><option timestep="0.001"/><worldbody>
  <body><freejoint name="root"/><geom size="0.1" mass="5"/>
    <body><joint name="arm" axis="0 1 0"/><geom size="0.01" pos="0.1 0 0" mass="0.001"/></body></body></worldbody>
  <actuator><motor name="arm" joint="arm"/></actuator></mujoco>
"""


def boxes(memory: str) -> str:
    one = "<body pos='{} 0 0.05'><freejoint/><geom type='box' size='.06 .06 .06'/></body>"
    bodies = "".join(one.format(0.1 * number) for number in range(10))
    floor = "<geom type='plane' size='1 1 1'/>"
    return f"<mujoco><size memory='{memory}'/><worldbody>{floor}{bodies}</worldbody></mujoco>"


def simulation(text: str) -> tuple[Any, Any]:
    set_mujoco_callbacks()
    model = mujoco.MjModel.from_xml_string(text)
    keep_divergence(model)
    return model, mujoco.MjData(model)


def test_a_diverging_joint_is_named_and_the_model_is_not_reset() -> None:
    model, data = simulation(ARM)
    while not (fault := mujoco_fault(model, data)):
        data.ctrl[0] = -0.05 * data.qvel[6] + 1e-6
        mujoco.mj_step(model, data)
    assert 0.001 < data.time < 0.1
    assert fault.startswith(
        f"the simulation became unstable after {data.time:.4g} s: the acceleration of joint 'arm' grew"
    )
    assert "time step of 0.001 s; lower gains that are too high for so light a joint, give it more armature" in fault
    assert np.abs(data.qvel).max() > 1e6, "MuJoCo would have put it back to where it began"
    mujoco.mj_resetData(model, data)
    assert mujoco_fault(model, data) == ""


@pytest.mark.parametrize("key", ["qpos", "qvel"])
def test_a_posture_that_is_no_number_is_named(key: str) -> None:
    model, data = simulation(ARM)
    getattr(data, key)[-1] = np.nan
    mujoco.mj_step(model, data)
    what = {"qpos": "position", "qvel": "velocity"}[key]
    assert f"the {what} of joint 'arm' grew without bound" in mujoco_fault(model, data)


def test_a_control_signal_that_is_no_number_is_named() -> None:
    model, data = simulation(ARM)
    data.ctrl[0] = np.nan
    mujoco.mj_step(model, data)
    assert np.isfinite(data.qacc).all(), "MuJoCo takes zero instead"
    fault = mujoco_fault(model, data)
    assert fault == "after 0.001 s the control signal of actuator 'arm' was nan; correct the controller"
    data.ctrl[0] = 1e12
    assert "a control signal is too large; lower gains" in mujoco_fault(model, data)


def test_full_buffers_are_a_fault() -> None:
    model, data = simulation(boxes("100K"))
    mujoco.mj_step(model, data, 3)
    assert np.isfinite(data.qacc).all()
    assert "forces of contacts were left out" in mujoco_fault(model, data)
    model, data = simulation(boxes("10M"))
    mujoco.mj_step(model, data, 3)
    assert mujoco_fault(model, data) == ""
