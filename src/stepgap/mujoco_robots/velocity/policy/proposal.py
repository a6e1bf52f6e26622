"""What a network and a model say of the settings of a policy, and what is left to fill in."""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as ET

from stepgap.base.settings_file import toml_line
from stepgap.mujoco_robots.trial import NetworkParts, Parts
from stepgap.mujoco_robots.velocity.policy.policy_settings import TERMS
from stepgap.mujoco_robots.velocity.policy.training_formats import GYM_TERMS, JOINT_TERMS, MOTION_TERMS, Training

_LAYOUTS: Final = {
    "mjlab, MuJoCo Playground": (*MOTION_TERMS, *JOINT_TERMS, "command"),
    "Isaac Lab": (*MOTION_TERMS, "command", *JOINT_TERMS),
    "mjlab without base_lin_vel": (*MOTION_TERMS[1:], *JOINT_TERMS, "command"),
    "Isaac Lab without base_lin_vel": (*MOTION_TERMS[1:], "command", *JOINT_TERMS),
    "unitree_rl_gym": GYM_TERMS,
}
"""Usual observations."""

_PER_JOINT: Final = ("default_joint_pos", "action_scale", "stiffness", "damping")
_USUAL_PERIOD: Final = 0.02  # Time between two actions in most trainings [s]; the metadata of mjlab does not have it


class Proposal(NamedTuple):
    """What is known of the settings of a policy, in part.

    Attributes:
        values: Values of the settings by their keys.
        advice: What is to be checked, or how a missing setting is to be filled in, in lines, by its key.
    """

    values: Mapping[str, Any]
    advice: Mapping[str, Sequence[str]]


def propose_policy(network: NetworkParts, model: Parts, training: Training | None) -> Proposal:
    """The settings as far as the training or the model has them.

    Args:
        training: What is known of the training, None if nothing.
    """
    said = dict(training.values) if training else {}
    values: dict[str, Any] = {"timestep": model.timestep}
    values |= {key: value for key, value in said.items() if key not in (*_PER_JOINT, "joints", "observation")}
    ticks = max(1, round(_USUAL_PERIOD / values["timestep"]))  # a period is a multiple of the time step
    values.setdefault("period", round(ticks * values["timestep"], 9))
    advice = {key: ["Check it: no file says it."] for key in ("timestep", "period") if key not in said}
    if training:
        advice["policy"] = [f"Its settings are from {training.source}."]
        advice["policy"] += ["Not used: " + "; ".join(training.unused) + "."] if training.unused else []
        advice |= {key: [line] for key, line in training.checks.items()}
    _propose_joints(said, training.keyframe if training else "", network, model, values, advice)
    for key in _PER_JOINT:
        numbers = said.get(key, [])
        if len(numbers) in (1, network.outputs):
            values.setdefault(key, numbers)
    if "action_scale" not in values:
        advice["action_scale"] = ["Fill it in, such as 0.25 or 0.5:"]
    if "stiffness" not in values and not (model.servos and all(model.servos)):
        advice["stiffness"] = ["Fill it in, and damping: not every joint has a position servo with gains in the model."]
    imus = sorted((site for site in model.sites if "imu" in site.lower()), key=lambda site: "pelvis" not in site)
    if values.get("imu") not in model.sites:
        values["imu"] = next(iter(imus), "")
        advice["imu"] = ["Check it: the name of a site of the model."]
    _propose_observation(said, network, values, advice)
    return Proposal(values, advice)


def _propose_joints(
    said: Mapping[str, Any],
    keyframe: str,
    network: NetworkParts,
    model: Parts,
    values: dict[str, Any],
    advice: dict[str, list[str]],
) -> None:
    """Adds the joints and their default positions."""
    joints = [_in_model(name, list(model.addresses)) for name in said.get("joints", [])]
    driven = driven_joints(model)
    unknown = [name for name, of_model in zip(said.get("joints", []), joints, strict=True) if not of_model]
    values["joints"] = joints or driven
    if not joints and not keyframe:
        advice["joints"] = ["Check the order: it is that of the model, not of the training."]
    # Gains and scales of the training are in its order of the joints, so that of the model would give them to others.
    if unknown or len(values["joints"]) != network.outputs:
        del values["joints"]
        advice["joints"] = [f"Fill in the joints of the {network.outputs} actions; the model has these {len(driven)}:"]
        advice["joints"].append(toml_line("joints", driven))
        if unknown:
            names = ", ".join(map(str, unknown))
            advice["joints"].append(f"The training names joints that the model does not have: {names:.300}")
    positions = said.get("default_joint_pos", [])
    if values.get("joints") is joints and len(positions) == network.outputs:
        values["default_joint_pos"] = positions
    elif "joints" in values:
        name = next((name for name in (keyframe, "home", *model.keyframes) if name in model.keyframes), "")
        posture = model.keyframes.get(name, model.start)
        values["default_joint_pos"] = [posture[model.addresses[joint]] for joint in values["joints"]]
        others = [f"{other!r:.40}" for other in model.keyframes if other != name]
        where = f"keyframe {name!r}" if name else "first posture"
        advice["default_joint_pos"] = [f"Check it: it is the {where} of the model."]
        advice["default_joint_pos"] += [f"Its other keyframes are {', '.join(others):.300}."] if others else []
        if name == keyframe != "":
            del advice["default_joint_pos"]
    elif len(positions) != network.outputs:
        advice["default_joint_pos"] = ["Fill in one number for each joint."]


def driven_joints(model: Parts) -> list[str]:
    """Joints that the actuators of a model move, in their order; all hinges and slides of a model without actuators."""
    return [joint for joint in model.driven if joint in model.addresses] or list(model.addresses)


def _propose_observation(
    said: Mapping[str, Any], network: NetworkParts, values: dict[str, Any], advice: dict[str, list[str]]
) -> None:
    """Adds the terms of the observation, or the usual ones that would fit."""
    names = said.get("observation", [])
    if names and all(name in TERMS for name in names):
        values["observation"] = names
        return
    lines = [f"Fill it in: the order and terms of the training, {network.inputs} numbers together."]
    if names:
        unknown = ", ".join(name for name in names if name not in TERMS)
        lines.append(f"Of the terms that the policy names, there is no {unknown:.200}: {', '.join(names):.600}")
    for what, terms in _LAYOUTS.items():
        size = sum(_term_size(term, network.outputs) for term in terms)
        if network.inputs % size == 0:
            lines.append(f"{what}{f', history {network.inputs // size}' if network.inputs > size else ''}:")
            lines.append(toml_line("observation", terms))
    advice["observation"] = lines


def _term_size(term: str, joints: int) -> int:
    """Number of values of a term of the observation."""
    if term in JOINT_TERMS:
        return joints
    return 1 if "phase" in term else 3


def completed_model(text: str, model: Parts, joints: Sequence[str]) -> tuple[str, list[str]]:
    """A model with ground, and with position servos of its joints, if it has none; and what was added.

    Args:
        text: The model, in MJCF.
        joints: Joints that get servos, whose gains are to be set.
    """
    root = ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    added = list[str]()
    if not model.ground:
        world = root.find("worldbody")
        ET.SubElement(ET.SubElement(root, "worldbody") if world is None else world, "geom", _GROUND)
        added.append("ground")
    if not model.actuators:
        servos = ET.SubElement(root, "actuator")
        for joint in joints:
            ET.SubElement(servos, "position", {"name": joint, "joint": joint})
        added.append("position servos")
    ET.indent(root)
    return f"{ET.tostring(root, 'unicode')}\n", added


_GROUND: Final = {"name": "ground", "type": "plane", "size": "0 0 0.05"}


def _in_model(name: str, joints: Sequence[str]) -> str:
    """A joint of the model that has this name, perhaps after a prefix such as `robot/`; empty if there is none."""
    fitting = [joint for joint in joints if joint == name] or [joint for joint in joints if joint.endswith(f"/{name}")]
    return fitting[0] if len(fitting) == 1 else ""
