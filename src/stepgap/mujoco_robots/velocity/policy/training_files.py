"""What trainings and their tools write beside a policy, or into it, as settings of `policy.toml`.

`training_of` finds what fits a policy: the metadata of its network, a file in one of the `TRAINING_FORMATS`, or the
sizes of a network of MuJoCo Playground.
"""

from collections.abc import Iterator, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Final

from stepgap.base.errors import InputError
from stepgap.base.files import read_bounded_text
from stepgap.base.versions import optional_package
from stepgap.mujoco_robots.trial import NetworkParts
from stepgap.mujoco_robots.velocity.policy.training_formats import (
    JOINT_TERMS,
    LARGEST_TRAINING_FILE,
    MOTION_TERMS,
    TRAINING_FORMATS,
    ObservedTerm,
    Training,
    observation_settings,
)
from stepgap.mujoco_robots.velocity.policy.yaml_text import parse_yaml

_MOST_FILES: Final = 50  # Most files of a folder that are looked at
_PLACES: Final = (".", "params", "..", "../params", "../io_descriptors")
"""Where the file may be, from the folder of the network."""


def training_of(network: NetworkParts, policy: Path, joints: Sequence[str], driven: Sequence[str]) -> Training | None:
    """What is known of a policy by its metadata, by a file beside it, or by the form of its network; None if nothing.

    Args:
        policy: Its file.
        joints: Hinges and slides of the model in its order.
        driven: Those that its actuators move, in their order.

    Raises:
        InputError: Several files of one folder could belong to it.
    """
    said = _metadata(network.metadata)
    file = next(_of_folders(policy, network.outputs, joints, driven), None)
    if said and "observation" in said.values:
        times = {key: file.values[key] for key in ("timestep", "period") if key in file.values} if file else {}
        return said._replace(values={**times, **said.values})
    named = [*network.ends] == ["obs", "continuous_actions"]
    return file or said or (_PLAYGROUND.get((network.inputs, network.outputs)) if named else None)


def _of_folders(policy: Path, outputs: int, joints: Sequence[str], driven: Sequence[str]) -> Iterator[Training]:
    """What the files of each folder say of a policy with these outputs, the nearest folder first."""
    for place in _PLACES:
        folder = policy.parent / place
        paths = sorted(folder.glob("*.y*ml"))[:_MOST_FILES] if folder.is_dir() else []
        fitting = []
        if paths:
            optional_package("yaml", str(paths[0]), "policy")
        for path in paths:
            try:
                table = parse_yaml(read_bounded_text(path, LARGEST_TRAINING_FILE))
            except (OSError, ValueError):  # another file, which is no concern of ours
                continue
            trainings = [said for reader in TRAINING_FORMATS if (said := reader(table, path, joints, driven))]
            fitting += [said for said in trainings if len(said.values.get("default_joint_pos", ())) == outputs]
        if len(fitting) > 1:
            names = " and ".join(Path(said.source).name for said in fitting)
            raise InputError(f"{policy}: {names} could both belong to it; leave only its own file in {folder}")
        yield from fitting


def _metadata(metadata: Mapping[str, str]) -> Training | None:
    """What mjlab and others write into an ONNX file: lists with commas, in which lists have semicolons."""
    said = {key: _items(text) for key, text in metadata.items()}
    names = said.get("observation_names", [])
    lists = {key: [_floats(item.split(";")) for item in said.get(key, [])] for key in _OF_TERMS}
    used = {"observation_names", "default_joint_pos"} & said.keys()
    used |= {key for key in _OF_TERMS if lists[key] and len(lists[key]) == len(names) and all(lists[key])}
    values: dict[str, Any] = {}
    if joints := next((key for key in ("action_joint_names", "joint_names") if key in said), ""):
        values["joints"] = said[joints]
        used.add(joints)
    for key, setting in _OF_JOINTS.items():
        if numbers := _floats(said.get(key, [])):
            values[setting] = numbers
            used.add(key)
    plain = [[1.0]] * len(names)
    scales = lists[_SCALE] if _SCALE in used else plain
    histories = next((lists[key] for key in _HISTORY if key in used), plain)
    terms = [ObservedTerm(*term) for term in zip(names, scales, (int(times) for times, *_ in histories), strict=True)]
    unused = [key for key in sorted(said.keys() - used) if not (key in _NEUTRAL and set(said[key]) <= _NEUTRAL[key])]
    if not values and not names:
        return None
    return Training("the metadata of the network", values | observation_settings(terms), unused)


_SCALE: Final = "observation_terms_scale"
_HISTORY: Final = ("observation_terms_history_length", "observation_history_lengths")
_OF_TERMS: Final = (_SCALE, *_HISTORY)  # Metadata with an entry for each term
_OF_JOINTS: Final = {
    "default_joint_pos": "default_joint_pos",
    "action_scale": "action_scale",
    "joint_stiffness": "stiffness",
    "joint_damping": "damping",
}
_NEUTRAL: Final = {"observation_terms_clip": {"-inf;inf"}, "observation_terms_flatten_history_dim": {"1.000", "True"}}
"""Metadata that may be ignored if they have no other entries than these."""


def _playground(name: str, keyframe: str, **values: Any) -> Training:
    """The joystick policy of a robot of MuJoCo Playground."""
    terms = (*MOTION_TERMS, "command", *JOINT_TERMS, "phase_cos", "phase_sin")
    usual = {"period": 0.02, "timestep": 0.002, "action_scale": [0.5], "observation": [*terms], "imu": "imu"}
    clock = {} if "observation" in values else {"gait_period": 1 / 1.5, "gait_offsets": [0.0, 0.5]}
    source = f"MuJoCo Playground, whose {name} has a network of this size"
    return Training(source, usual | clock | values, keyframe=keyframe)


_STANDS: Final = {"gait_stands_below": 0.01, "gait_standing": [0.5, 0.5]}
_QUICKENS: Final = {"gait_period": 0.8, "gait_quickening": 0.5 / 1.5, "gait_quickens_to": 1.5}
_HEAD: Final = {term: [0.0, 0.0, *[1.0] * 21] for term in ("joint_pos", "joint_vel")}  # It is not observed
_PLAYGROUND: Final[Mapping[tuple[int, int], Training]] = {
    (48, 12): _playground("Go1Joystick", "home", timestep=0.004, observation=[*MOTION_TERMS, *JOINT_TERMS, "command"]),
    (52, 12): _playground("BerkeleyHumanoidJoystick", "home"),
    (103, 29): _playground("G1Joystick", "knees_bent", imu="imu_in_pelvis"),
    (85, 23): _playground("T1Joystick", "home", action_scale=[1.0], scale=_HEAD, **_STANDS),
    (112, 32): _playground("ApolloJoystick", "knees_bent", timestep=0.005, **_QUICKENS, **_STANDS),
}
"""Policies of MuJoCo Playground by the numbers of inputs and outputs."""


def _items(text: str) -> list[str]:
    """Items of a list in metadata: separated by commas, perhaps as JSON."""
    return [word for part in text.strip(" []").split(",") if (word := part.strip(" \"'"))]


def _floats(items: Sequence[str]) -> list[float]:
    """Texts as finite numbers; none if one is something else."""
    try:
        numbers = [float(item) for item in items]
    except ValueError:
        return []
    return numbers if all(map(isfinite, numbers)) else []
