"""The folder of a robot with a MuJoCo model that `stepgap new --mjcf` makes."""

import shutil
import warnings
from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.files import create
from stepgap.cli.new_package import Starter, class_name, starter_text, write_robot
from stepgap.mujoco_robots.mjcf.model_files import ASSETS, MODEL_FILE, model_files
from stepgap.mujoco_robots.trial import Parts, parts_of_model

TEXTS = "stepgap.mujoco_robots.cli"  # Package with the texts that the folders begin with

MJCF = Starter("mjcf.py.txt", "simulator", "controller, state and section")
_PLACES = {
    True: "Addresses of the height in data.qpos, and of the rates of height and forward place in data.qvel",
    False: "No joint moves the model up and forward; choose other coordinates of data.qpos and data.qvel",
}
"""What the addresses are, if the model has them, or not."""


def write_mjcf_robot(folder: Path, name: str, model: Path) -> None:
    """Writes the files of a robot with a MuJoCo model, which is copied with all its files, and loaded.

    Args:
        folder: An empty folder.
        name: Name of the robot.
        model: The model, MJCF or URDF.

    Raises:
        InputError: The model cannot be copied, or its copy cannot be loaded.
    """
    starter = starter_text(MJCF.file, TEXTS)
    class_ = class_name(name, starter)
    parts = copied_model(model, folder)
    _warn_of_missing(model, parts)
    code = _code_of_model(starter, name, class_, parts)
    copied = [file for file in (MODEL_FILE, ASSETS) if (folder / file).exists()]
    write_robot(folder, name, MJCF, class_, code, copied)


def _warn_of_missing(model: Path, parts: Parts) -> None:
    """Warns of what a model lacks that every step needs, as a URDF does, which describes a robot without its world."""
    missing = {
        "no actuators, such as <motor joint=…/> in <actuator>": not parts.actuators,
        "no joint that moves the robot, such as <freejoint/> in its first body": "height" not in parts.coordinates,
        'no ground, such as <geom type="plane" size="50 50 1"/> in <worldbody>': not parts.ground,
    }
    if lacking := [text for text, is_missing in missing.items() if is_missing]:
        shown = f"--mjcf {model} has {'; '.join(lacking)}: add what the robot needs to {MODEL_FILE}"
        warnings.warn(shown, StepGapWarning, stacklevel=2)


def copied_model(model: Path, folder: Path) -> Parts:
    """Copies a model and its files into a folder, and loads the copy in another process.

    Raises:
        InputError: The model cannot be copied, or its copy cannot be loaded.
    """
    try:
        contents = model_files(model)
    except InputError as error:
        raise InputError(f"--mjcf {error}") from None
    for name, content in contents.items():
        target = folder / name
        target.parent.mkdir(exist_ok=True)
        if isinstance(content, Path):
            shutil.copyfile(content, target)
        else:
            create(target, content)
    try:
        parts = parts_of_model(folder / MODEL_FILE)
    except ValueError as error:
        hint = "; expand its macros by xacro first" if "xacro" in str(contents[MODEL_FILE]) else ""
        raise InputError(f"--mjcf {model}: {error}{hint}") from None
    try:
        same = parts_of_model(model).same == parts.same
    except ValueError:  # such as a URDF whose packages MuJoCo does not find
        same = True
    if not same:
        raise InputError(f"--mjcf {model}: its copy is another model; save it by MuJoCo in one file first")
    return parts


def _code_of_model(starter: str, name: str, class_name: str, parts: Parts) -> str:
    """Code of a robot from a model, whose names are literals in ASCII, so that they are never code."""
    addresses = {"height": 0, "rise": 0, "speed": 0} | parts.coordinates
    start = parts.start[addresses["height"]] if parts.start else 0.0
    low, high = (start * 0.8, start * 1.2) if start > 0.01 else (start - 0.1, start + 0.1)
    return Template(starter).substitute(
        {key: str(value) for key, value in addresses.items()},
        name=name,
        joints=ascii(parts.joints),
        actuators=ascii(parts.actuators),
        geoms=_dictionary(parts.geoms),
        touching=ascii(parts.touching),
        place=_PLACES[len(parts.coordinates) == len(addresses)],
        low=f"{low:.3f}",
        high=f"{high:.3f}",
        fallen=f"{start - 2.5 * (start - low):.3f}",
        **{"class": class_name},
    )


def _dictionary(lists: Mapping[Any, Any]) -> str:
    """Code of a dictionary, with an entry in each line."""
    return "\n".join(["{", *(f"    {key!a}: {value!a}," for key, value in lists.items()), "}"])
