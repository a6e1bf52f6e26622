"""Files of trainings beside a policy become its settings, in the order of its joints."""

from pathlib import Path

import pytest

from stepgap.base.errors import InputError
from stepgap.mujoco_robots.trial import NetworkParts
from stepgap.mujoco_robots.velocity.policy.training_files import training_of
from stepgap.mujoco_robots.velocity.policy.training_formats import Training

JOINTS = ("a", "b", "c")

UNITREE = """
joint_ids_map: [2, 0, 1]
step_dt: 0.02
stiffness: [10, 20, 30]
damping: [1.0, 2.0, 3.0]
default_joint_pos: [0.3, 0.1, 0.2]
commands: {base_velocity: {ranges: {lin_vel_x: [-0.5, 1.0]}}}
actions:
  JointPositionAction: {clip: null, scale: [0.25, 0.25, 0.5], offset: [0.3, 0.1, 0.2]}
observations:
  base_ang_vel: {params: {}, clip: null, scale: [0.2, 0.2, 0.2], history_length: 1}
  joint_vel_rel: {clip: [-9, 9], scale: [0.05, 0.05, 0.1], history_length: 1}
  gait_phase: {params: {period: 0.6}, scale: [1.0, 1.0], history_length: 1}
"""

ISAAC = """
actions:
- {name: joint_position_action, clip: null, joint_names: [c, a, b], offset: [0.3, 0.1, 0.2], scale: 0.25}
articulations:
  robot:
    joint_names: [a, b, c]
    default_joint_pos: [0.1, 0.2, 0.3]
    default_joint_stiffness: [10, 20, 30]
    default_joint_damping: [1, 2, 3]
observations:
  policy:
  - name: generated_commands
    overloads: {clip: null, history_length: 0, scale: null}
  - name: joint_pos_rel
    joint_names: [c, a, b]
    overloads: {clip: null, history_length: 3, scale: 0.5}
scene: {decimation: 4, dt: 0.02, physics_dt: 0.005}
"""

RL_SAR = """
dog/robot_lab:
  observations: ["ang_vel", "commands", "dof_vel"]
  observations_history: [0, 1, 2]
  observations_history_priority: "time"
  clip_actions_lower: [-100, -100, -100]
  clip_actions_upper: [100, 100, 100]
  rl_kp: [30, 10, 20]
  rl_kd: [3, 1, 2]
  action_scale: [0.25, 0.25, 0.5]
  wheel_indices: []
  ang_vel_scale: 0.25
  dof_vel_scale: 0.05
  commands_scale: [2.0, 2.0, 0.25]
  default_dof_pos: [0.3, 0.1, 0.2]
  joint_mapping: [2, 0, 1]
"""
BASE = "dog:\n  dt: 0.005\n  decimation: 4\n  joint_names: [a, b, c]\n"

GYM = """
simulation_dt: 0.002
control_decimation: 10
kps: [10, 20]
kds: [1, 2]
default_angles: [0.1, 0.2]
ang_vel_scale: 0.25
dof_pos_scale: 1.0
action_scale: 0.25
cmd_scale: [2.0, 2.0, 0.25]
num_actions: 2
"""


def read(folder: Path, outputs: int = 3, metadata: dict[str, str] | None = None) -> Training:
    network = NetworkParts(99, outputs, metadata or {})
    training = training_of(network, folder / "run" / "exported" / "policy.onnx", JOINTS, JOINTS)
    assert training
    return training


def write(folder: Path, name: str, text: str) -> None:
    path = folder / "run" / name
    path.parent.mkdir(parents=True, exist_ok=True)
    (folder / "run" / "exported").mkdir(exist_ok=True)
    path.write_text(text)


def test_deploy_yaml_of_unitree_has_gains_by_motor_and_all_else_by_joint(tmp_path: Path) -> None:
    write(tmp_path, "exported/note.yaml", "a: [1")
    write(tmp_path, "params/deploy.yaml", UNITREE)
    training = read(tmp_path)
    assert training.values == {
        "joints": ["c", "a", "b"],
        "period": 0.02,
        "default_joint_pos": [0.3, 0.1, 0.2],
        "action_scale": [0.25, 0.25, 0.5],
        "stiffness": [30.0, 10.0, 20.0],
        "damping": [3.0, 1.0, 2.0],
        "gait_period": 0.6,
        "observation": ["base_ang_vel", "joint_vel", "phase_sin", "phase_cos"],
        "scale": {"base_ang_vel": [0.2], "joint_vel": [0.05, 0.05, 0.1]},
    }
    assert training.unused == ["clip of joint_vel_rel: [-9, 9]"]
    assert training.commands == {"vx": [-0.5, 1.0]}
    assert training.checks.keys() == {"joints"}


def test_motors_of_a_quadruped_of_unitree_have_an_order_of_their_own(tmp_path: Path) -> None:
    legs = [f"{leg}_{part}_joint" for leg in ("FL", "FR", "RL", "RR") for part in ("hip", "thigh", "calf")]
    twelve = {"joint_ids_map": [3, 4, 5, 0, 1, 2, 9, 10, 11, 6, 7, 8], "default_joint_pos": [0.1] * 12}
    (tmp_path / "deploy.yaml").write_text(
        "\n".join([*(f"{key}: {value}" for key, value in twelve.items()), "observations: {}"])
    )
    training = training_of(NetworkParts(45, 12, {}), tmp_path / "policy.onnx", legs, legs)
    assert training
    assert training.values["joints"] == legs, "the training had the order of the model"
    assert not training.checks


def test_io_descriptors_of_isaac_lab_have_the_joints_by_name(tmp_path: Path) -> None:
    write(tmp_path, "io_descriptors/IO_descriptors.yaml", ISAAC)
    training = read(tmp_path)
    assert training.values == {
        "joints": ["c", "a", "b"],
        "timestep": 0.005,
        "period": 0.02,
        "default_joint_pos": [0.3, 0.1, 0.2],
        "action_scale": [0.25],
        "stiffness": [30.0, 10.0, 20.0],
        "damping": [3.0, 1.0, 2.0],
        "observation": ["command", "joint_pos"],
        "history": [1, 3],
        "scale": {"joint_pos": [0.5]},
    }
    assert training.unused == ["limits, friction and armature of the joints"]


def test_a_term_with_other_joints_is_none_of_ours(tmp_path: Path) -> None:
    write(tmp_path, "IO_descriptors.yaml", ISAAC.replace("    joint_names: [c, a, b]", "    joint_names: [a, b]"))
    assert read(tmp_path).values["observation"] == ["command", "joint_pos_rel of its own"]
    write(tmp_path, "IO_descriptors.yaml", ISAAC.replace("offset: [0.3, 0.1, 0.2]", "offset: 0.7"))
    assert "offset of the actions, which is not default_joint_pos" in read(tmp_path).unused
    write(tmp_path, "IO_descriptors.yaml", ISAAC.replace("joint_names: [c, a, b], offset", "joint_names: 5, offset"))
    network = NetworkParts(99, 3, {})
    assert training_of(network, tmp_path / "run" / "exported" / "policy.onnx", JOINTS, JOINTS) is None


def test_config_of_rl_sar_has_times_and_names_in_the_base_of_its_robot(tmp_path: Path) -> None:
    write(tmp_path, "exported/config.yaml", RL_SAR)
    write(tmp_path, "base.yaml", BASE)
    training = read(tmp_path)
    assert training.values == {
        "joints": ["c", "a", "b"],
        "timestep": 0.005,
        "period": 0.02,
        "default_joint_pos": [0.3, 0.1, 0.2],
        "action_scale": [0.25, 0.25, 0.5],
        "action_clip": 100.0,
        "stiffness": [30.0, 10.0, 20.0],
        "damping": [3.0, 1.0, 2.0],
        "observation": ["base_ang_vel", "command", "joint_vel"],
        "history": [3],
        "history_by_term": False,
        "newest_first": True,
        "scale": {"base_ang_vel": [0.25], "command": [2.0, 2.0, 0.25], "joint_vel": [0.05]},
    }
    write(tmp_path, "exported/config.yaml", RL_SAR.replace("wheel_indices: []", "wheel_indices: [2]"))
    assert "wheel_indices, whose joints it moves by velocities" in read(tmp_path).unused


def test_configs_of_unitree_rl_gym_have_the_first_joints_of_the_model(tmp_path: Path) -> None:
    write(tmp_path, "exported/g1.yaml", GYM)
    training = read(tmp_path, 2)
    assert training.values["joints"] == ["a", "b"]
    assert (training.values["timestep"], training.values["period"]) == (0.002, 0.02)
    assert training.values["stiffness"] == [10.0, 20.0]
    assert training.values["observation"][-2:] == ["phase_sin", "phase_cos"]
    assert training.values["scale"] == {"base_ang_vel": [0.25], "command": [2.0, 2.0, 0.25]}
    write(tmp_path, "exported/h1.yaml", GYM)
    with pytest.raises(InputError, match=r"g1\.yaml and h1\.yaml could both belong to it; leave only its own"):
        read(tmp_path, 2)


def test_metadata_come_first_but_have_no_times(tmp_path: Path) -> None:
    write(tmp_path, "params/deploy.yaml", UNITREE)
    said = {"observation_names": "command", "default_joint_pos": "1,2,3"}
    assert read(tmp_path, 3, said).values == {
        "period": 0.02,
        "default_joint_pos": [1.0, 2.0, 3.0],
        "observation": ["command"],
    }
    assert read(tmp_path, 3, {"run_path": "x"}).values["period"] == 0.02


def test_a_file_of_another_robot_or_a_damaged_one_says_nothing(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    for text in (UNITREE, "joint_ids_map: 5\nobservations: {}\n", "observations: {a: 5}\njoint_ids_map: [9e9]", "\0"):
        (tmp_path / "deploy.yaml").write_text(text)
        assert training_of(NetworkParts(9, 2, {}), tmp_path / "policy.onnx", JOINTS, JOINTS) is None


def test_policies_of_mujoco_playground_are_known_by_ends_and_sizes(tmp_path: Path) -> None:
    ends = ["obs", "continuous_actions"]
    training = training_of(NetworkParts(112, 32, {}, ends), tmp_path / "p.onnx", JOINTS, JOINTS)
    assert training
    assert training.keyframe == "knees_bent"
    assert training.values["gait_quickening"] == pytest.approx(1 / 3)
    assert training_of(NetworkParts(112, 32, {}, ["obs", "actions"]), tmp_path / "p.onnx", JOINTS, JOINTS) is None
