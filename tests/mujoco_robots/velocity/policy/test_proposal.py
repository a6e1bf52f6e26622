"""What metadata and model say becomes settings; what they do not say is left to be filled in."""

# pyright: reportAttributeAccessIssue=false

import tomllib
from pathlib import Path
from xml.etree import ElementTree as ET

import mujoco
import pytest

from stepgap.mujoco_robots.trial import NetworkParts, Parts, parts_of_model
from stepgap.mujoco_robots.velocity.policy.policy_model import standing_height
from stepgap.mujoco_robots.velocity.policy.proposal import Proposal, completed_model, driven_joints, propose_policy
from stepgap.mujoco_robots.velocity.policy.training_files import training_of
from tests.mujoco_robots.velocity.policy.networks import TERMS, WHEELS, cart_xml, mjlab_metadata


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Parts:
    path = tmp_path_factory.mktemp("cart") / "m.xml"
    keys = '<keyframe><key name="low"/><key name="home" qpos="0 0 .1 1 0 0 0 .1 .2 .3 .4"/></keyframe>'
    path.write_text(cart_xml(keys))
    return parts_of_model(path)


def proposed(network: NetworkParts, model: Parts, policy: Path = Path("nowhere/policy.onnx")) -> Proposal:
    training = training_of(network, policy, list(model.addresses), driven_joints(model))
    return propose_policy(network, model, training)


def test_metadata_of_mjlab_say_all_but_the_times(parts: Parts) -> None:
    found = proposed(NetworkParts(24, 4, mjlab_metadata()), parts)
    assert found.values == {
        "timestep": 0.002,
        "period": 0.02,
        "joints": list(WHEELS),
        "default_joint_pos": [0.0] * 4,
        "action_scale": [1.0],
        "stiffness": [2.0] * 4,
        "damping": [0.8] * 4,
        "imu": "imu_site",
        "observation": list(TERMS),
    }
    assert found.advice.keys() == {"policy", "timestep", "period", "imu"}
    assert found.advice["policy"] == [
        "Its settings are from the metadata of the network.",
        "Not used: command_names; run_path.",
    ]


def test_scales_and_histories_of_mjlab_are_used_and_what_is_not_is_named(parts: Parts) -> None:
    said = mjlab_metadata() | {
        "observation_names": "base_ang_vel,joint_vel,command,actions",
        "observation_terms_scale": "1.000,0.050,2.000;2.000;0.250,1.000",
        "observation_terms_history_length": "0.000,5.000,0.000,2.000",
        "observation_terms_clip": "-inf;inf,-100.000;100.000,-inf;inf,-inf;inf",
        "observation_terms_flatten_history_dim": "1.000,0.000,1.000,1.000",
    }
    found = proposed(NetworkParts(34, 4, said), parts)
    assert found.values["scale"] == {"joint_vel": [0.05], "command": [2.0, 2.0, 0.25]}
    assert found.values["history"] == [1, 5, 1, 2]
    unused = "command_names; observation_terms_clip; observation_terms_flatten_history_dim; run_path"
    assert found.advice["policy"][1] == f"Not used: {unused}."
    short = proposed(NetworkParts(34, 4, said | {"observation_terms_scale": "1.000"}), parts)
    assert "observation_terms_scale" in short.advice["policy"][1]
    assert "scale" not in short.values


def test_metadata_of_others_are_understood_too(parts: Parts) -> None:
    said = mjlab_metadata() | {
        "observation_names": '["base_ang_vel", "velocity_commands", "last_action"]',
        "observation_terms_history_length": "",
        "observation_terms_scale": "",
        "observation_history_lengths": "1,5,2",
        "action_scale": "[0.5, 0.5, 0.25, 0.25]",
        "action_joint_names": ",".join(reversed(WHEELS)),
    }
    prefixed = parts._replace(addresses={f"robot/{name}": address for name, address in parts.addresses.items()})
    found = proposed(NetworkParts(26, 4, said), prefixed).values
    assert found["observation"] == ["base_ang_vel", "command", "actions"]
    assert found["history"] == [1, 5, 2]
    assert found["action_scale"] == [0.5, 0.5, 0.25, 0.25]
    assert found["joints"] == [f"robot/{wheel}" for wheel in reversed(WHEELS)]


def test_without_metadata_the_model_is_asked_and_the_rest_is_to_be_filled_in(parts: Parts) -> None:
    found = proposed(NetworkParts(24, 4, {}), parts)
    assert found.values["joints"] == list(WHEELS)
    assert found.values["default_joint_pos"] == [0.1, 0.2, 0.3, 0.4]
    assert not {"action_scale", "observation", "stiffness"} & found.values.keys()
    lines = found.advice["observation"]
    assert lines[1:4:2] == ["mjlab, MuJoCo Playground:", "Isaac Lab:"]
    assert tomllib.loads(lines[2]) == {"observation": list(TERMS)}
    several = proposed(NetworkParts(48, 4, {}), parts).advice["observation"]
    assert "mjlab, MuJoCo Playground, history 2:" in several


def test_terms_and_joints_that_are_unknown_are_said(parts: Parts) -> None:
    said = mjlab_metadata() | {"observation_names": "base_ang_vel,height_scan", "joint_names": "a,b"}
    found = proposed(NetworkParts(99, 2, said), parts)
    assert "there is no height_scan: base_ang_vel, height_scan" in found.advice["observation"][1]
    assert found.advice["joints"][0] == "Fill in the joints of the 2 actions; the model has these 4:"
    assert "joints" not in found.values


def test_gains_of_joints_that_the_model_calls_otherwise_are_not_given_to_its_joints_in_their_order(
    parts: Parts,
) -> None:
    other = ",".join(f"base_{name}" for name in WHEELS)
    found = proposed(NetworkParts(24, 4, mjlab_metadata() | {"joint_names": other}), parts)
    assert "joints" not in found.values
    assert found.advice["joints"][2].startswith("The training names joints that the model does not have: base_front_l")


@pytest.mark.parametrize("text", ["nan", "1,2", "0.5;0.5", "", "'__import__'"])
def test_numbers_that_are_none_are_not_used(parts: Parts, text: str) -> None:
    found = proposed(NetworkParts(24, 4, mjlab_metadata() | {"action_scale": text}), parts)
    assert "action_scale" not in found.values


def test_a_model_without_ground_and_actuators_gets_them_once(tmp_path: Path, parts: Parts) -> None:
    text, added = completed_model(cart_xml(), parts, WHEELS)
    assert added == ["ground", "position servos"]
    model = mujoco.MjModel.from_xml_string(text)
    assert [model.joint(model.actuator_trnid[k, 0]).name for k in range(model.nu)] == list(WHEELS)
    (tmp_path / "m.xml").write_text(text)
    complete = parts_of_model(tmp_path / "m.xml")
    assert complete.ground
    assert complete.servos == [True] * 4
    assert completed_model(text, complete, WHEELS)[1] == []
    assert ET.fromstring(text).find("worldbody/body") is not None
    assert standing_height(WHEELS, [0.0] * 4, tmp_path / "m.xml") == pytest.approx(0.1)
