"""A policy moves a robot exactly as its weights say, and files that do not fit are refused by one sentence."""

# pyright: reportAttributeAccessIssue=false

import re
from copy import deepcopy
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import tomli_w

from stepgap.base.errors import InputError
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.velocity.policy.onnx_network import OnnxNetwork
from stepgap.mujoco_robots.velocity.policy.policy_model import policy_spec
from stepgap.mujoco_robots.velocity.policy.policy_robot import PolicyControl, PolicyFile, PolicyRobot
from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings, read_policy_settings
from stepgap.mujoco_robots.velocity.walking_robot import Walk
from stepgap.step import Array, StepStatus
from tests.mujoco_robots.velocity.policy.networks import TERMS, WHEELS, cart_xml, driving, write_network
from tests.robots.plug_in import section_of

GROUND = '<geom name="ground" type="plane" size="0 0 1"/>'
SETTINGS: dict[str, Any] = {
    "policy": "policy.onnx",
    "model": "model.xml",
    "timestep": 0.002,
    "period": 0.02,
    "joints": list(WHEELS),
    "default_joint_pos": [0.0] * 4,
    "action_scale": [1.0],
    "observation": list(TERMS),
    "stiffness": [2.0],
    "damping": [0.8],
}


BOX = '<body name="box" pos="3 0 0.1"><freejoint/><geom size="0.1"/></body>'


def actuators(kind: str, attributes: str = "") -> str:
    each = "".join(f'<{kind} name="{wheel}" joint="{wheel}" {attributes}/>' for wheel in reversed(WHEELS))
    return f"<actuator>{each}</actuator>"


def written(folder: Path, weights: Array | None = None, model: str = "", **changes: Any) -> Path:
    """A `policy.toml` of the cart with these changes; None leaves a key out."""
    write_network(folder / "policy.onnx", driving() if weights is None else weights)
    (folder / "model.xml").write_text(model or cart_xml(actuators("position"), GROUND))
    table = {key: value for key, value in (SETTINGS | changes).items() if value is not None}
    (folder / "policy.toml").write_text(tomli_w.dumps(table))
    return folder / "policy.toml"


def robot_of(file: Path) -> PolicyRobot:
    return PolicyRobot(walk=Walk(fall_height=0.05), policy=PolicyFile(str(file)))


def test_targets_are_default_positions_plus_scaled_and_clipped_actions_in_the_order_of_the_joints(
    tmp_path: Path,
) -> None:
    weights = np.random.default_rng(0).normal(size=(4, 7))
    joints, default, scale = [*reversed(WHEELS[:2]), *WHEELS[2:]], [0.1, 0.2, 0.3, 0.4], [0.5, 1.0, 2.0, 4.0]
    file = written(
        tmp_path,
        weights,
        observation=["command", "actions"],
        joints=joints,
        default_joint_pos=default,
        action_scale=scale,
        action_clip=0.6,
    )
    settings = read_policy_settings(file)
    model = policy_spec(settings, file).compile()
    data = mujoco.MjData(model)
    control = PolicyControl(settings, OnnxNetwork(tmp_path / "policy.onnx"))
    control.start(model, data)
    command, actions = np.array([0.4, -0.2, 0.7]), np.zeros(4)
    for _ in range(3):
        found = control.control(model, data, command)
        actions = np.clip(weights @ np.concatenate([command, actions]), -0.6, 0.6)
        by_joint = dict(zip(joints, np.array(default) + np.array(scale) * actions, strict=True))
        np.testing.assert_allclose(found, [by_joint[wheel] for wheel in reversed(WHEELS)], atol=1e-6)
    copied = deepcopy(control)
    ahead = [each.control(model, data, command).tolist() for each in (control, copied)]
    assert ahead[0] == ahead[1], "a copy has the same memory"
    control.start(model, data)
    first = control.control(model, data, command)
    assert first.tolist() != ahead[0], "a start forgets the actions"


@pytest.mark.parametrize("kind", ["position", "motor"])
@pytest.mark.parametrize("gear", [1.0, -3.0])
def test_gains_of_the_training_are_those_of_the_joints_whatever_the_actuators_were(
    tmp_path: Path, kind: str, gear: float
) -> None:
    limits = 'ctrllimited="true" ctrlrange="-50 50"' if kind == "motor" else ""
    model = cart_xml(actuators(kind, f'gear="{gear}" {limits}'), GROUND)
    file = written(tmp_path, model=model, stiffness=[20.0, 30.0, 40.0, 50.0], damping=[0.5])
    compiled = policy_spec(read_policy_settings(file), file).compile()
    data, rng = mujoco.MjData(compiled), np.random.default_rng(0)
    position, velocity, target = rng.normal(size=(3, 4)) / 10
    data.qpos[7:], data.qvel[6:], data.ctrl[:] = position, velocity, target[::-1]
    mujoco.mj_forward(compiled, data)
    expected = np.array([20.0, 30.0, 40.0, 50.0]) * (target - position) - 0.5 * velocity
    np.testing.assert_allclose(data.qfrc_actuator[6:], expected, rtol=1e-9)
    if kind == "motor":
        data.ctrl[:] = 10000.0
        mujoco.mj_forward(compiled, data)
        np.testing.assert_allclose(np.abs(data.qfrc_actuator[6:]), 50 * abs(gear), rtol=1e-9)


def test_gains_of_the_training_are_implicit_and_those_of_the_model_are_its_own(tmp_path: Path) -> None:
    """A link of 10 g with a damping of 10 N·m·s/rad is unstable at 2 ms by explicit steps, as Euler's are."""
    euler = cart_xml(actuators("position", 'kp="2" kv="0.8"'), GROUND).replace('integrator="implicitfast"', "")
    file = written(tmp_path, model=euler)
    implicit = int(mujoco.mjtIntegrator.mjINT_IMPLICITFAST)
    assert policy_spec(read_policy_settings(file), file).option.integrator == implicit
    file = written(tmp_path, model=euler, stiffness=None, damping=None)
    assert policy_spec(read_policy_settings(file), file).option.integrator == int(mujoco.mjtIntegrator.mjINT_EULER)


def test_a_clock_that_depends_on_the_command_is_the_sum_of_its_frequencies(tmp_path: Path) -> None:
    clock: dict[str, Any] = {
        "gait_period": 0.8,
        "gait_quickening": 0.5,
        "gait_quickens_to": 0.6,
        "gait_stands_below": 0.01,
    }
    weights = np.array([[1.0, 0.0], [0.0, 1.0], [0.0, 0.0], [0.0, 0.0]])
    file = written(tmp_path, weights, observation=["phase_sin", "phase_cos"], **clock)
    settings = read_policy_settings(file)
    model = policy_spec(settings, file).compile()
    data = mujoco.MjData(model)
    control = PolicyControl(settings, OnnxNetwork(tmp_path / "policy.onnx"))
    control.start(model, data)
    sizes = [0.5, 5.0, 0.0, 0.5]
    found = [control.control(model, data, np.array([0.6 * size, 0.8 * size, 0.0]))[:1:-1].tolist() for size in sizes]
    turns = 0.02 * np.cumsum([0.0, 1.25 + 0.25, 1.25 + 0.3, 1.25])
    expected = np.array([np.sin(2 * np.pi * turns), np.cos(2 * np.pi * turns)]).T
    expected[2] = 0.0  # told to stand
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_it_starts_on_the_ground_in_its_default_posture_and_drives_as_commanded(tmp_path: Path) -> None:
    robot = robot_of(written(tmp_path, default_joint_pos=[0.1, 0.0, 0.0, 0.2], timestep=0.004))
    assert robot.tick == 0.004
    model = robot.mjcf_model()
    data = mujoco.MjData(model)
    robot.place(model, data, np.zeros(3))
    assert data.qpos[2] == pytest.approx(0.1, abs=1e-9), "wheels with a radius of 0.1 m touch the ground"
    assert data.qpos[7:] == pytest.approx([0.1, 0.0, 0.0, 0.2])
    assert data.ctrl[::-1] == pytest.approx([0.1, 0.0, 0.0, 0.2])
    speeds = []
    for command in ([0.3, 0.0, 0.0], [0.6, 0.0, 0.0]):
        plant = MjcfPlant(robot, np.random.default_rng(0))
        plant.start()
        record = [plant.take_step(np.array(command)) for _ in range(4)][-1]
        assert record.status == StepStatus.OK
        speeds.append(record.next_state[0])
    assert speeds[1] > speeds[0] + 0.1 > 0.2


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"observation": [*TERMS[1:]]}, "observation: its terms have 21 numbers (base_ang_vel 3, projected_gravity 3"),
        ({"history": [2]}, "command 3, history 2), but policy.onnx wants 24; give the terms of the training"),
        ({"observation": None}, "observation: missing; it must be given"),
        ({"observation": ["base_lin_vle"]}, "observation = 'base_lin_vle', but it must be made of base_lin_vel, base_"),
        ({"observation": []}, "observation = [], but it must have at least one term"),
        ({"observaton": []}, "observaton: unknown key; did you mean observation?"),
        ({"joints": "FR"}, "joints = 'FR', but it must be a list of strings"),
        ({"damping": 0.8}, "damping = 0.8, but it must be a list of numbers"),
        ({"joints": ["front_left"] * 4}, "joints = ['front_left', 'front_left', 'front_left', 'front_left'], but"),
        ({"joints": [*WHEELS[:3], "wheel"]}, "joints has 'wheel', but the hinges and slides of the model are front"),
        ({"default_joint_pos": [0.0] * 3}, "default_joint_pos = [0.0, 0.0, 0.0], but it must have 4 numbers, not 3"),
        ({"action_scale": [1.0, 2.0]}, "action_scale = [1.0, 2.0], but it must have 1 or 4 numbers, not 2"),
        ({"period": 0.003}, "period = 0.003, but it must be a multiple of timestep = 0.002"),
        ({"period": np.inf}, "period = inf, but it must be positive, and at most 1"),
        ({"timestep": 0.0}, "timestep = 0.0, but it must lie between 0 and 0.02"),
        ({"stiffness": []}, "damping = [0.8], but it must have 0 numbers, not 1"),
        ({"stiffness": [-2.0]}, "stiffness = [-2.0], but it must not be negative"),
        ({"scale": {"command": [1.0, 2.0]}}, "[scale] command = [1.0, 2.0], but it must have 1 or 3 numbers, not 2"),
        ({"history": [0]}, "history = [0], but it must lie from 1 to 1000"),
        ({"history": [1, 2, 1, 1, 1, 1, 1], "history_by_term": False}, "history_by_term = false, but it must be true"),
        ({"imu": "head"}, "imu = 'head', but the model has no such site"),
        ({"policy": "none.onnx"}, "none.onnx: No such file or directory; export the policy"),
        ({"model": "none.xml"}, "model = none.xml: "),
        ({"model": cart_xml(actuators("motor")), "stiffness": [], "damping": []}, "the actuator of joint front_left"),
        ({"model": cart_xml(actuators("motor")).replace("<freejoint/>", "")}, "its first body has no free joint"),
        ({"model": cart_xml(ground=BOX)}, "its first body, 'box', has no hinges or slides; put the robot before other"),
        ({"model": cart_xml(actuators("motor", 'gear="0"'))}, "the actuator of joint front_left has gear 0"),
        ({"model": cart_xml()}, "joint front_left has 0 actuators in the model; it must have one"),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_file_and_key(tmp_path: Path, changes: dict[str, Any], words: str) -> None:
    text = changes.get("model", "")
    others = {key: value for key, value in changes.items() if key != "model"}
    file = written(tmp_path, None, text if "<" in text else "", **others)
    if text and "<" not in text:
        file.write_text(file.read_text().replace('"model.xml"', f'"{text}"'))
    robot = robot_of(file)
    with pytest.raises(InputError) as found:
        _ = robot.mjcf_spec(), robot.walking_control()
    assert str(found.value).startswith(str(tmp_path)), found.value
    assert words in str(found.value)


def test_actions_and_joints_have_the_same_number(tmp_path: Path) -> None:
    robot = robot_of(written(tmp_path, np.zeros((3, 24))))
    with pytest.raises(InputError, match=r"joints: there are 4, but policy.onnx has 3 actions; give a joint for each"):
        robot.walking_control()


def test_other_joints_keep_their_control_signals(tmp_path: Path) -> None:
    weights = np.ones((1, 3))
    changes = {"joints": ["rear_left"], "default_joint_pos": [0.0], "observation": ["command"]}
    file = written(tmp_path, weights, **changes)
    settings = read_policy_settings(file)
    assert isinstance(settings, PolicySettings)
    model = policy_spec(settings, file).compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = [1.0, 2.0, 3.0, 4.0]
    control = PolicyControl(settings, OnnxNetwork(tmp_path / "policy.onnx"))
    control.start(model, data)
    assert control.control(model, data, np.array([0.1, 0.2, 0.3])) == pytest.approx([1.0, 0.6, 3.0, 4.0])


def test_the_policy_of_the_documentation_is_valid(tmp_path: Path) -> None:
    section = section_of("policy.md", "The file policy.toml")
    block = re.findall(r"```toml\n(.*?)```", section, re.DOTALL)[0]
    (tmp_path / "policy.toml").write_text(block, "utf-8")
    assert read_policy_settings(tmp_path / "policy.toml").sizes["joint_pos"] == 3
    assert all(f"`{term}`" in section for term in TERMS)
