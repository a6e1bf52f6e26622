"""The files in YAML that trainings and their tools write beside a policy, as settings of `policy.toml`.

Each format has a function that makes a `Training` of it: `TRAINING_FORMATS`.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import Any, Final, NamedTuple

from stepgap.base.files import read_bounded_text
from stepgap.mujoco_robots.velocity.policy.yaml_text import parse_yaml

LARGEST_TRAINING_FILE: Final = 2**20  # Largest file that is read [bytes]

ALIASES: Final[Mapping[str, str]] = {
    **dict.fromkeys(("velocity_commands", "twist", "generated_commands", "commands"), "command"),
    "last_action": "actions",
    **dict.fromkeys(("joint_pos_rel", "dof_pos"), "joint_pos"),
    **dict.fromkeys(("joint_vel_rel", "dof_vel"), "joint_vel"),
    "lin_vel": "base_lin_vel",
    "ang_vel": "base_ang_vel",
    "gravity_vec": "projected_gravity",
}
"""Other names of terms: those of mjlab, Isaac Lab and rl_sar."""

MOTION_TERMS: Final = ("base_lin_vel", "base_ang_vel", "projected_gravity")
JOINT_TERMS: Final = ("joint_pos", "joint_vel", "actions")
GYM_TERMS: Final = (*MOTION_TERMS[1:], "command", *JOINT_TERMS, "phase_sin", "phase_cos")
"""Observation of unitree_rl_gym."""

_CLOCK: Final = ("phase_sin", "phase_cos")  # What `gait_phase` is
_RANGES: Final = {"vx": "lin_vel_x", "vy": "lin_vel_y", "wz": "ang_vel_z"}  # Names of commands in deploy.yaml
_MOTORS: Final = [f"{leg}_{part}_joint" for leg in ("FR", "FL", "RR", "RL") for part in ("hip", "thigh", "calf")]
"""Motors of Unitree's quadrupeds in their own order."""


class Training(NamedTuple):
    """What is known of a policy by one file.

    Attributes:
        source: The file, for comments.
        values: Settings by their keys, `scale` as a table; terms that StepGap does not have keep their names.
        unused: What else the file says, which is not used.
        checks: What is to be checked of settings, by their keys.
        commands: Smallest and largest commands of the training, by the names of the velocities.
        keyframe: Name of the keyframe with the default positions, if they are not in `values`.
    """

    source: str
    values: Mapping[str, Any]
    unused: Sequence[str] = ()
    checks: Mapping[str, str] = {}
    commands: Mapping[str, Sequence[float]] = {}
    keyframe: str = ""


class ObservedTerm(NamedTuple):
    """A term of the observation: its name, its factors, and the number of times that are given."""

    name: str
    scale: Sequence[float] = ()
    history: int = 1


def _unitree(table: Any, path: Path, joints: Sequence[str], driven: Sequence[str]) -> Training | None:
    """`deploy.yaml` of unitree_rl_lab and unitree_rl_mjlab; its map has the motor of each joint of the policy."""
    observed = _at(table, "observations")
    if not isinstance(observed, dict) or "joint_ids_map" not in table:
        return None
    motors = _MOTORS if {*driven} == {*_MOTORS} else driven
    order = _numbers(table["joint_ids_map"])
    terms, unused = _described((str(name), term, _at(term, "params", "asset_cfg")) for name, term in observed.items())
    ranges = {key: _numbers(_at(table, "commands", "base_velocity", "ranges", name)) for key, name in _RANGES.items()}
    commands = {key: pair for key, pair in ranges.items() if len(pair) == 2 and pair[0] < pair[1]}
    action = _at(table, "actions", "JointPositionAction")
    values = _in_order(_settings(table), order, ("stiffness", "damping")) | {"joints": _picked(motors, order)}
    check = {"joints": "Check: its motors are those of the actuators of the model, in their order."}
    checks = {} if motors is _MOTORS else check
    unused += _unused_of_action(action, values)
    settings = _given(values) | observation_settings(terms)
    return Training(source=str(path), values=settings, unused=unused, checks=checks, commands=commands)


def _isaac_lab(table: Any, path: Path, joints: Sequence[str], driven: Sequence[str]) -> Training | None:
    """`IO_descriptors.yaml` of Isaac Lab."""
    actions = _at(table, "actions")
    observed = _at(table, "observations", "policy")
    all_joints = _at(table, "articulations", "robot", "joint_names")
    if not all(isinstance(part, list) for part in (actions, observed, all_joints)):
        return None
    action = actions[0] if len(actions) == 1 else {}
    names = _at(action, "joint_names")
    names = names if isinstance(names, list) else []
    order = [float(all_joints.index(name)) for name in names if name in all_joints]
    others = [_at(term, "joint_names") not in (None, names) or None for term in observed]
    terms, unused = _described(
        (str(_at(term, "name")), _at(term, "overloads"), other) for term, other in zip(observed, others, strict=True)
    )
    values = _in_order(_settings(table), order, ("default_joint_pos", "stiffness", "damping"))
    values |= {"joints": names, "action_scale": _numbers(_at(action, "scale"))}
    unused += ["limits, friction and armature of the joints", *_unused_of_action(action, values)]
    return Training(str(path), _given(values) | observation_settings(terms), unused)


def _described(terms: Iterable[tuple[str, Any, Any]]) -> tuple[list[ObservedTerm], list[str]]:
    """Terms by their names, tables, and what is not None if they have other joints; and what is not used of them."""
    read = []
    unused = []
    for name, table, other in terms:
        own = name == "joint_pos" or other is not None  # their `joint_pos` is not less the default positions
        history = int(_number(_at(table, "history_length")))
        read.append(ObservedTerm(f"{name} of its own" if own else name, _numbers(_at(table, "scale")), history))
        if _at(table, "clip") is not None:
            unused.append(f"clip of {name}: {_at(table, 'clip')}")
    return read, unused


def _unused_of_action(action: Any, values: Mapping[str, Any]) -> list[str]:
    """What is not used of an action: limits of the targets, and targets that are not around the default positions."""
    clip = [f"clip of the targets: {_at(action, 'clip')}"] if _at(action, "clip") is not None else []
    other = _numbers(_at(action, "offset")) not in ([], [0.0], values["default_joint_pos"])
    return [*clip, *(["offset of the actions, which is not default_joint_pos"] if other else [])]


def _rl_sar(table: Any, path: Path, joints: Sequence[str], driven: Sequence[str]) -> Training | None:
    """`config.yaml` of rl_sar, and `base.yaml` of the robot in the folder above."""
    said: Any = next(iter(table.values()), None) if isinstance(table, dict) and len(table) == 1 else None
    if _at(said, "rl_kp") is None or not isinstance(_at(said, "observations"), list):
        return None
    try:
        base = next(iter(parse_yaml(read_bounded_text(path.parent / "../base.yaml", LARGEST_TRAINING_FILE)).values()))
    except (OSError, ValueError, AttributeError, StopIteration):
        base = {}
    said = {**base, **said} if isinstance(base, dict) else said
    names = said.get("joint_names")
    values = _settings(said)
    values["joints"] = _picked(names if isinstance(names, list) else driven, _numbers(said.get("joint_mapping")))
    unused = ["clip_obs, torque_limits, fixed_kp and fixed_kd"]
    clip = {abs(bound) for key in ("clip_actions_lower", "clip_actions_upper") for bound in _numbers(said.get(key))}
    if len(clip) == 1:
        values["action_clip"] = clip.pop()
    else:
        unused.append("clip_actions_lower and clip_actions_upper, which differ by the joint")
    times = _numbers(said.get("observations_history"))
    if len(times) > 1:
        values["history_by_term"] = said.get("observations_history_priority") == "term"
        values["newest_first"] = times[0] == 0
    unused += [f"observations_history: {times}"] if sorted(times) != [*range(len(times))] else []
    unused += ["wheel_indices, whose joints it moves by velocities"] if said.get("wheel_indices") else []
    terms = _scaled(said["observations"], said, max(1, len(times)))
    return Training(str(path), _given(values) | observation_settings(terms), unused)


def _unitree_rl_gym(table: Any, path: Path, joints: Sequence[str], driven: Sequence[str]) -> Training | None:
    """A file in `deploy/…/configs` of unitree_rl_gym; its joints are those of the model in order."""
    if _at(table, "kps") is None or _at(table, "cmd_scale") is None:
        return None
    values = _settings(table) | {"joints": [*joints[: int(_number(table.get("num_actions")))]], "gait_period": 0.8}
    unused = ["arms and waist, which the machine holds"] if "arm_waist_kps" in table else []
    checks = {"joints": "Check: they are the first joints of the model, in its order."}
    return Training(str(path), _given(values) | observation_settings(_scaled(GYM_TERMS, table, 1)), unused, checks)


_KEYS: Final[Mapping[str, Sequence[str]]] = {
    "timestep": ("dt", "simulation_dt", "scene/physics_dt"),
    "period": ("step_dt", "control_dt", "scene/dt"),
    "default_joint_pos": (
        "default_joint_pos",
        "default_dof_pos",
        "default_angles",
        "articulations/robot/default_joint_pos",
    ),
    "action_scale": ("action_scale", "actions/JointPositionAction/scale"),
    "stiffness": ("stiffness", "rl_kp", "kps", "articulations/robot/default_joint_stiffness"),
    "damping": ("damping", "rl_kd", "kds", "articulations/robot/default_joint_damping"),
    "gait_period": ("observations/gait_phase/params/period",),
}
"""Where settings are in the files, by unitree_rl_lab and unitree_rl_mjlab, rl_sar, unitree_rl_gym, Isaac Lab."""

_SCALES: Final[Mapping[str, Sequence[str]]] = {
    "base_lin_vel": ("lin_vel_scale",),
    "base_ang_vel": ("ang_vel_scale",),
    "joint_pos": ("dof_pos_scale",),
    "joint_vel": ("dof_vel_scale",),
    "command": ("commands_scale", "cmd_scale"),
}
"""Where factors on terms are in the files of rl_sar and unitree_rl_gym."""


def _settings(table: Any) -> dict[str, Any]:
    """The settings that a file has under the names of `_KEYS`."""
    values: dict[str, Any] = {key: _first(table, names) for key, names in _KEYS.items()}
    for key in ("timestep", "period", "gait_period"):
        values[key] = values[key][0] if values[key] else 0.0
    ticks = _first(table, ("decimation", "control_decimation"))
    if ticks and not values["period"]:
        values["period"] = round(values["timestep"] * ticks[0], 9)
    return values


def _scaled(names: Sequence[Any], table: Any, history: int) -> list[ObservedTerm]:
    """Terms with the factors that a file has under the names of `_SCALES`."""
    terms = [ALIASES.get(str(name), str(name)) for name in names]
    return [ObservedTerm(term, _first(table, _SCALES.get(term, ())), history) for term in terms]


def _first(table: Any, names: Sequence[str]) -> list[float]:
    """The numbers under the first of these names that has any; a slash separates a table and a name in it."""
    return next((numbers for name in names if (numbers := _numbers(_at(table, *name.split("/"))))), [])


def _in_order(values: Mapping[str, Any], order: Sequence[float], keys: Sequence[str]) -> dict[str, Any]:
    """Settings, of which some are in another order of the joints."""
    return {**values, **{key: _picked(values[key], order) for key in keys}}


_Reader = Callable[[Any, Path, Sequence[str], Sequence[str]], Training | None]
TRAINING_FORMATS: Final[Sequence[_Reader]] = (_unitree, _isaac_lab, _rl_sar, _unitree_rl_gym)
"""Make a `Training` of a table; None if it has another format. They get its file, and `joints` and `driven`."""


def observation_settings(terms: Sequence[ObservedTerm]) -> dict[str, Any]:
    """Settings of the observation with these terms."""
    names: list[str] = []
    histories: list[int] = []
    scale: dict[str, list[float]] = {}
    for term in terms:
        history = max(1, term.history)
        clock = term.name == "gait_phase" and history == 1
        for name in _CLOCK if clock else [ALIASES.get(term.name, term.name)]:
            names.append(name)
            histories.append(history)
            if set(term.scale) - {1.0}:
                scale[name] = [term.scale[0]] if len({*term.scale}) == 1 else [*term.scale]
    same = len({*histories}) == 1
    values = {"observation": names, "history": histories[:1] if same else histories, "scale": scale}
    return {key: value for key, value in values.items() if value and value != [1]}


def _given(values: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that a file has, with finite numbers."""
    return {key: value for key, value in values.items() if value is False or value not in (None, [], 0)}


def _at(value: Any, *keys: str) -> Any:
    """What is under keys in tables within each other; None if it is not there."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value


def _picked(items: Sequence[Any], order: Sequence[float]) -> list[Any]:
    """Items by their numbers; none if there are not so many."""
    numbers = [int(number) for number in order]
    return [items[number] for number in numbers] if all(0 <= number < len(items) for number in numbers) else []


def _number(value: Any) -> float:
    """A finite number; 0 if it is none."""
    return float(value) if type(value) in (int, float) and isfinite(value) else 0.0


def _numbers(value: Any) -> list[float]:
    """A list of finite numbers, or one of them; none if it is something else."""
    items = value if isinstance(value, list) else [value]
    fine = all(type(item) in (int, float) and isfinite(item) for item in items)
    return [float(item) for item in items] if fine else []
