"""Whether MuJoCo can load a model, and what is in it, without a risk for this process."""

import json
import signal
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final, NamedTuple

_SECONDS: Final = 60
"""Longest time of a processor that a model may need [s]."""

_MEMORY: Final = 4 * 2**30
"""Largest memory that a model may need [bytes]."""

_TRIAL: Final = Path(__file__).with_name("trial.py")


class Parts(NamedTuple):
    """What is in a model; a part without a name has an empty one.

    Attributes:
        joints: Names of the joints, in the order of `qpos`.
        actuators: Names of the actuators, in the order of `ctrl`.
        geoms: By the name of each body, or its number if it has none, the names of its geoms, or their numbers.
        touching: The geoms that can touch another one, without those of the world.
        coordinates: Addresses `height` in `qpos`, `rise` and `speed` in `qvel`, of the robot's place, as far as known.
        start: The first posture, `qpos0`.
        addresses: Addresses in `qpos` of hinges and slides, by the name of the joint.
        driven: Joint that each actuator moves, empty if it moves none; in the order of `ctrl`.
        servos: Whether each actuator is a position servo or another one with a bias.
        keyframes: Their `qpos`, by the name of the keyframe, or its number if it has none.
        sites: Names of the sites.
        ground: Whether a plane or a height field is fixed to the world.
        timestep: Time step of the simulation [s].
        same: Equal for the same model.
    """

    joints: list[str]
    actuators: list[str]
    geoms: dict[str | int, list[str | int]]
    touching: list[str | int]
    coordinates: dict[str, int]
    start: list[float]
    addresses: dict[str, int]
    driven: list[str]
    servos: list[bool]
    keyframes: dict[str, list[float]]
    sites: list[str]
    ground: bool
    timestep: float
    same: str


def parts_of_model(model: Path, seconds: int = _SECONDS, memory: int = _MEMORY) -> Parts:
    """Loads a model in another process.

    Args:
        model: The file.
        seconds: As `_SECONDS`.
        memory: As `_MEMORY`.

    Raises:
        ValueError: It cannot be loaded, or needs more; the message is the reason.
    """
    return _parts(description(_TRIAL, model, "MuJoCo", seconds, memory))


def description(
    program: Path, file: Path, reader: str, seconds: int = _SECONDS, memory: int = _MEMORY
) -> Mapping[str, Any]:
    """What a program prints of a file, in another process with limits.

    Args:
        program: Program that calls `print_described` of `trial.py`.
        file: The file.
        reader: What reads it, for messages.
        seconds: As `_SECONDS`.
        memory: As `_MEMORY`.

    Raises:
        ValueError: It cannot be loaded, or needs more; the message is the reason.
    """
    with TemporaryDirectory() as folder:  # MuJoCo writes a log into the current folder
        command = [sys.executable, "-P", str(program), str(file.resolve()), str(seconds), str(memory)]
        try:
            done = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=5 * seconds, check=False)
        except subprocess.TimeoutExpired:
            raise ValueError(f"{reader} does not load it within {5 * seconds} s") from None
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise ValueError(f"{reader} needs more than {seconds} s to load it")
    try:
        answer = json.loads(done.stdout)
    except ValueError:
        reason = " ".join(done.stderr.split())[-200:] or f"code {done.returncode}"
        raise ValueError(f"{reader} ends while it loads it: {reason}") from None
    if "error" in answer:
        raise ValueError(f"{answer['error']:.300}")
    return answer


def _parts(answer: Mapping[str, Any]) -> Parts:
    bodies = [name or number for number, name in enumerate(answer["bodies"])]
    geoms: dict[str | int, list[str | int]] = {}
    for number, (name, body) in enumerate(answer["geoms"]):
        geoms.setdefault(bodies[body], []).append(name or number)
    touching = [answer["geoms"][k][0] or k for k in answer["touching"] if answer["geoms"][k][1] > 0]
    others = {key: answer[key] for key in Parts._fields if key not in ("geoms", "touching")}
    return Parts(geoms=geoms, touching=touching, **others)
