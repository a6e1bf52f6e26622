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
    from stepgap.mujoco_robots.velocity.policy.policy_model import standing_height
    from stepgap.mujoco_robots.velocity.policy.policy_robot import PolicyFile, PolicyRobot
    from stepgap.mujoco_robots.velocity.policy.proposal import completed_model, driven_joints, propose_policy
    from stepgap.mujoco_robots.velocity.policy.training_files import training_of
    from stepgap.mujoco_robots.velocity.walking_robot import Walk

    try:
        content = read_network(policy)
        network = parts_of_network(policy)
    except ValueError as error:
        raise InputError(f"--policy {error}") from None
    create(folder / NETWORK_FILE, content)
    parts = copied_model(mjcf, folder)
    model = folder / MODEL_FILE
    try:
        training = training_of(network, policy, list(parts.addresses), driven_joints(parts))
    except ValueError as error:
        raise InputError(f"--policy {error}") from None
    found = propose_policy(network, parts, training)
    ranges = _ranges(training.commands if training else {})
    known = {"policy": NETWORK_FILE, "model": MODEL_FILE, **found.values}
    joints = known.get("joints", [])
    positions = known.get("default_joint_pos", [])
    text, added = completed_model(model.read_text("utf-8"), parts, joints)
    if added:
        write_whole(model, text)
    create(folder / POLICY_FILE, _policy_toml(found._replace(values=known)))
    missing = _missing(known, found.advice)
    seconds, gait = step_seconds(known), ""
    try:
        height = standing_height(joints, positions, model)
        if not missing:
            walk = Walk(seconds=seconds, fall_height=0.5 * height, **ranges)
            robot = PolicyRobot(policy=PolicyFile(str(folder / POLICY_FILE)), walk=walk)
            seconds, gait = _seconds_by_gait(robot)
    except ValueError as error:
        raise InputError(f"--policy {policy}, --mjcf {mjcf}: {str(error).replace(f'{folder}/', '')}") from None
    todo = f"\n**First fill in {', '.join(missing)} in `policy.toml`.**\n" if missing else ""
    values = {
        "name": readme_name(name),
        "seconds": f"{seconds:.4g}",
        "fall_height": f"{0.5 * height:.3f}",
        "todo": todo,
        "ranges": "".join(f"\n[walk.{key}]\n{_lines_of(each)}" for key, each in ranges.items()),
        "added": "",
    }
    if added:
        values["added"] = f" It had no {' and no '.join(added)}, so they were added."
    for target, source in {"experiment.toml": "policy.toml.txt", "README.md": "README_policy.md.txt"}.items():
        create(folder / target, Template(starter_text(source, TEXTS)).substitute(values))
    return missing, gait


def _ranges(commands: Mapping[str, Sequence[float]]) -> dict[str, Any]:
    """Ranges of a walk by its velocities: the commands of the training, and the usual use as far as it lies in them."""
    from stepgap.mujoco_robots.velocity.walking_robot import VelocityRange, Walk

    ranges = dict[str, Any]()
    for name, (low, high) in commands.items():
        usual: VelocityRange = getattr(Walk(), name)
        lower, upper = max(usual.lower, low), min(usual.upper, high)
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


def step_seconds(known: Mapping[str, Any]) -> float:
    """Duration of a step [s]: whole periods of a gait with a clock, or else `STEP_SECONDS`.

    The mean velocity over a part of a period depends on where in the gait it begins.
    """
    from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings

    if not {"phase_sin", "phase_cos"} & set(known.get("observation", ())):
        return STEP_SECONDS
    period = float(known.get("gait_period", PolicySettings.gait_period))
    return period * max(1, round(STEP_SECONDS / period))


def _missing(known: Mapping[str, Any], advice: Mapping[str, Sequence[str]]) -> list[str]:
    """Settings that are not known, and have no default or one that does not fit."""
    from stepgap.mujoco_robots.velocity.policy.policy_settings import PolicySettings

    unknown = [each for each in fields(PolicySettings) if each.name not in known]
    return [each.name for each in unknown if each.default is MISSING or each.name in advice]


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
        lines += ["", *_comment(texts[entry.name]), *(f"# {_printable(line)}" for line in advice)]
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


def _printable(text: str) -> str:
    """A text of others on one line."""
    return "".join(each for each in text if each.isprintable())
