"""The folder of a robot with a trained policy that `stepgap new --policy` makes."""

from collections.abc import Mapping, Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from string import Template
from textwrap import wrap
from typing import TYPE_CHECKING, Any

from stepgap.base.errors import InputError
from stepgap.base.files import create, write_whole
from stepgap.cli.new_package import readme_name, starter_text
from stepgap.mujoco_robots.cli.new_model import TEXTS, copied_model

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.mujoco_robots.velocity.policy.policy_robot import PolicyRobot
    from stepgap.mujoco_robots.velocity.policy.proposal import Proposal

POLICY_FILE = "policy.toml"
NETWORK_FILE = "policy.onnx"
STEP_SECONDS = 0.5  # About how long a step lasts [s]
_WIDTH = 100  # Longest line of a comment


def write_policy(folder: Path, name: str, policy: Path, mjcf: Path) -> tuple[list[str], str]:
    """Writes the files of a robot that a policy moves.

    Args:
        folder: An empty folder.
        name: Its name.
        policy: Network of the policy, which is copied and tried.
        mjcf: MuJoCo model that is copied with all its files, and loaded.

    Returns:
        What is to be filled in, and what a walk shows of the gait, a sentence; empty if something is to be filled in.

    Raises:
        InputError: Network or model cannot be copied or loaded, or they do not fit.
    """
    from stepgap.mujoco_robots.mjcf.model_files import MODEL_FILE
    from stepgap.mujoco_robots.trial import parts_of_network
    from stepgap.mujoco_robots.velocity.policy.onnx_file import read_network
    from stepgap.mujoco_robots.velocity.policy.proposal import completed_model, driven_joints, propose_policy
    from stepgap.mujoco_robots.velocity.policy.training_files import training_of

    # Network and model are copied.
    try:
        content = read_network(policy)
        network = parts_of_network(policy)
    except ValueError as error:
        raise InputError(f"--policy {error}") from None
    create(folder / NETWORK_FILE, content)
    parts = copied_model(mjcf, folder)

    # What training and model say of the policy is written, and what the model lacks.
    try:
        training = training_of(network, policy, list(parts.addresses), driven_joints(parts))
    except ValueError as error:
        raise InputError(f"--policy {error}") from None
    proposal = propose_policy(network, parts, training)
    settings = {"policy": NETWORK_FILE, "model": MODEL_FILE, **proposal.values}
    model = folder / MODEL_FILE
    text, added = completed_model(model.read_text("utf-8"), parts, settings.get("joints", []))
    if added:
        write_whole(model, text)
    create(folder / POLICY_FILE, _policy_toml(proposal._replace(values=settings)))

    # A walk shows how long a step is.
    missing = _missing(settings, proposal.advice)
    ranges = _ranges(training.commands if training else {})
    try:
        seconds, fall_height, gait = _walk_of(folder, settings, ranges, is_complete=not missing)
    except ValueError as error:
        raise InputError(f"--policy {policy}, --mjcf {mjcf}: {str(error).replace(f'{folder}/', '')}") from None
    values = {
        "name": readme_name(name),
        "seconds": f"{seconds:.4g}",
        "fall_height": f"{fall_height:.3f}",
        "todo": f"\n**First fill in {', '.join(missing)} in `policy.toml`.**\n" if missing else "",
        "ranges": "".join(f"\n[walk.{key}]\n{_lines_of(ends)}" for key, ends in ranges.items()),
        "added": f" It had no {' and no '.join(added)}, so they were added." if added else "",
    }
    for target, source in {"experiment.toml": "policy.toml.txt", "README.md": "README_policy.md.txt"}.items():
        create(folder / target, Template(starter_text(source, TEXTS)).substitute(values))
    return missing, gait


def _walk_of(
    folder: Path, settings: Mapping[str, Any], ranges: Mapping[str, Any], is_complete: bool
) -> tuple[float, float, str]:
    """Duration of a step [s], height below which the robot has fallen [m], and what a walk shows of the gait.

    Without all settings, the robot stands, but does not walk.
    """
    from stepgap.mujoco_robots.mjcf.model_files import MODEL_FILE
    from stepgap.mujoco_robots.velocity.policy.policy_model import standing_height
    from stepgap.mujoco_robots.velocity.policy.policy_robot import PolicyFile, PolicyRobot
    from stepgap.mujoco_robots.velocity.walking_robot import Walk

    seconds = step_seconds(settings)
    joints = settings.get("joints", [])
    positions = settings.get("default_joint_pos", []) if joints else []
    fall_height = 0.5 * standing_height(joints, positions, folder / MODEL_FILE)
    if not is_complete:
        return seconds, fall_height, ""
    walk = Walk(seconds=seconds, fall_height=fall_height, **ranges)
    seconds, gait = _seconds_by_gait(PolicyRobot(policy=PolicyFile(str(folder / POLICY_FILE)), walk=walk))
    return seconds, fall_height, gait


def _ranges(commands: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Ranges of a walk by its velocities: the commands of the training, and the usual use as far as it lies in them."""
    from stepgap.mujoco_robots.velocity.walking_robot import VelocityRange, Walk

    ranges = dict[str, Any]()
    for name, (low, high) in commands.items():
        usual: VelocityRange = getattr(Walk(), name)
        lower = max(usual.lower, low)
        upper = min(usual.upper, high)
        ranges[name] = VelocityRange(*((lower, upper) if lower < upper else (low, high)), low, high)
    return ranges


def _lines_of(settings: Any) -> str:
    """The keys of settings with their values, in lines."""
    from stepgap.base.settings_file import to_table, toml_line

    return "".join(f"{toml_line(key, value)}\n" for key, value in to_table(settings).items())


def _seconds_by_gait(robot: "PolicyRobot") -> tuple[float, str]:
    """Duration of a step by a walk of the policy, and what that shows of its gait.

    A clock in the observation is more accurate than the walk, if both agree.
    """
    from stepgap.mujoco_robots.velocity.gait import gait_of
    from stepgap.mujoco_robots.velocity.walking_robot import measured_walk

    clock = robot.walk.seconds
    walk = measured_walk(robot)
    if walk is None:
        return clock, "the model falls at constant commands: compare policy.toml with the training (stepgap check)"
    gait = gait_of(walk, clock)
    seconds = clock if gait.fits(clock) else gait.whole_steps(STEP_SECONDS)
    words = gait_of(walk, seconds).in_words(robot.space)
    return seconds, f"the gait of the model: {words[0].lower()}{words[1:]}"


def step_seconds(values: Mapping[str, Any]) -> float:
    """Duration of a step [s]: whole periods of a gait with a clock, or else `STEP_SECONDS`.

    The mean velocity over a part of a period depends on where in the gait it begins.
    """
    from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings

    if not {"phase_sin", "phase_cos"} & set(values.get("observation", ())):
        return STEP_SECONDS
    period = float(values.get("gait_period", PolicySettings.gait_period))
    return period * max(1, round(STEP_SECONDS / period))


def _missing(values: Mapping[str, Any], advice: Mapping[str, Sequence[str]]) -> list[str]:
    """Settings that are not known, and have no default or one that does not fit."""
    from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings

    unknown = [entry for entry in fields(PolicySettings) if entry.name not in values]
    return [entry.name for entry in unknown if entry.default is MISSING or entry.name in advice]


def _policy_toml(proposal: "Proposal") -> str:
    """All settings of a policy with their meanings; a missing one is a comment, to be filled in."""
    from stepgap.base.settings_file import to_table, toml_line
    from stepgap.experiment.settings_text import meanings
    from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings, Scales

    lines = [
        "# A trained policy. Lines that say `Check` are guesses; where one says `Fill in`, remove the # before a key."
    ]
    texts = meanings(PolicySettings)
    for entry in fields(PolicySettings):
        if entry.name == "scale":
            continue
        advice = proposal.advice.get(entry.name, [])
        shown = ("".join(filter(str.isprintable, line)) for line in advice)  # it may have texts of others
        lines += ["", *_comment(texts[entry.name]), *(f"# {line}" for line in shown)]
        value = proposal.values.get(entry.name, entry.default)
        if value is not MISSING:
            lines.append(toml_line(entry.name, value))
        elif not any(line.startswith(f"{entry.name} = ") for line in advice):
            lines.append(f"# {entry.name} = []")
    lines += ["", *_comment(texts["scale"]), "[scale]"]
    for name, text in meanings(Scales).items():
        factors = proposal.values.get("scale", {}).get(name) or to_table(Scales())[name]
        lines += [*_comment(text), toml_line(name, factors)]
    return "\n".join([*lines, ""])


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in wrap(text, _WIDTH)]
