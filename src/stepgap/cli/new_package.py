"""The folders of robots in Python that `stepgap new` makes: from equations, or from a MuJoCo model."""

import keyword
import re
import shutil
from collections.abc import Mapping
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any, NamedTuple

from stepgap.base.errors import InputError
from stepgap.base.files import create

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.robots.mjcf.model_trial import Parts


class Starter(NamedTuple):
    """A robot in Python that a folder begins with.

    Attributes:
        file: Its file among the starters.
        kind: Name of its nominal map.
        what: What a user replaces, for the README.
    """

    file: str
    kind: str
    what: str


EQUATIONS = Starter("equations.py.txt", "equations", "equations")
MUJOCO = Starter("mujoco.py.txt", "simulator", "model and the controller")
MJCF = Starter("mjcf.py.txt", "simulator", "controller, state and section")
PACKAGE_NAME = "[A-Za-z]([A-Za-z0-9_]*[A-Za-z0-9])?"
"""Names that are valid for a module, a project and a key of TOML."""
_NAMED = re.compile(r'^class \w+\((\w*Robot)\):\n    name = ".*"$', re.MULTILINE)
"""The lines of a module that name its robot."""
_PLACES = {
    True: "Addresses of the height in data.qpos, and of the rates of height and forward place in data.qvel",
    False: "No joint moves the model up and forward; choose other coordinates of data.qpos and data.qvel",
}
"""What the addresses are, if the model has them, or not."""


def starter_text(name: str) -> str:
    """Text of a file among the starters."""
    return files("stepgap.cli").joinpath("starters", name).read_text("utf-8")


def readme_name(name: str) -> str:
    """A name as Markdown."""
    return re.sub(r"([^\w ])", r"\\\1", name)


def check_package_name(name: str) -> None:
    """Raises InputError unless a new robot in Python may have this name."""
    from stepgap.robots.entry_points import robot_names

    valid = re.fullmatch(PACKAGE_NAME, name) and not keyword.iskeyword(name)
    if not valid or name in robot_names() or find_spec(name):
        rule = (
            "letters from a to z, digits and underscores, a letter first and no underscore last, and no installed "
            "module or known robot has it"
        )
        raise InputError(f"{name}: not the name of a new Python module: {rule}; choose another")


def write_package(folder: Path, name: str, starter: Starter, model: Path | None) -> None:
    """Writes the files of a robot.

    Args:
        folder: An empty folder.
        name: Name of the robot.
        starter: What it begins with.
        model: MuJoCo model that is copied with all its files, and loaded; for `MJCF` only.

    Raises:
        InputError: The model cannot be copied, or its copy cannot be loaded.
    """
    from stepgap.robots.mjcf.model_files import ASSETS, MODEL_FILE

    text = starter_text(starter.file)
    class_name = _class_name(name, text)
    if model:
        code = _code_of_model(text, name, class_name, copied_model(model, folder))
    else:
        code = _NAMED.sub(rf'class {class_name}(\1):\n    name = "{name}"', text)
    copied = "".join(f', "{each}"' for each in (MODEL_FILE, ASSETS) if (folder / each).exists())
    values = {"name": name, "package": name.replace("_", "-"), "class": class_name, "model": copied}
    written = {
        "pyproject.toml": "pyproject.toml.txt",
        "experiment.toml": "experiment.toml.txt",
        f"test_{name}.py": "test_equations.py.txt",
        "README.md": "README_package.md.txt",
    }
    create(folder / f"{name}.py", code)
    for target, source in written.items():
        filled = Template(starter_text(source)).substitute(values, kind=starter.kind, what=starter.what)
        create(folder / target, filled)


def _class_name(name: str, code: str) -> str:
    """Name of the class of a robot, such as `MyRobot` of my_robot; with Robot at its end if its module uses that."""
    found = "".join(word[:1].upper() + word[1:] for word in name.split("_"))
    others = {*re.findall(r"\w+", _NAMED.sub(r"\1", code)), "True", "False", "None"}
    while found in others:
        found += "Robot"
    return found


def copied_model(model: Path, folder: Path) -> "Parts":
    """Copies a model and its files into a folder, and loads the copy in another process.

    Raises:
        InputError: The model cannot be copied, or its copy cannot be loaded.
    """
    from stepgap.robots.mjcf.model_files import MODEL_FILE, model_files
    from stepgap.robots.mjcf.model_trial import parts_of_model

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


def _code_of_model(starter: str, name: str, class_name: str, parts: "Parts") -> str:
    """Code of a robot from a model, whose names are literals in ASCII, so that they are never code."""
    known = {"height": 0, "rise": 0, "speed": 0} | parts.coordinates
    start = parts.start[known["height"]] if parts.start else 0.0
    low, high = (start * 0.8, start * 1.2) if start > 0.01 else (start - 0.1, start + 0.1)
    return Template(starter).substitute(
        {key: str(value) for key, value in known.items()},
        name=name,
        joints=ascii(parts.joints),
        actuators=ascii(parts.actuators),
        geoms=_dictionary(parts.geoms),
        touching=ascii(parts.touching),
        place=_PLACES[len(parts.coordinates) == len(known)],
        low=f"{low:.3f}",
        high=f"{high:.3f}",
        fallen=f"{start - 2.5 * (start - low):.3f}",
        **{"class": class_name},
    )


def _dictionary(lists: Mapping[Any, Any]) -> str:
    """Code of a dictionary, with an entry in each line."""
    return "\n".join(["{", *(f"    {key!a}: {value!a}," for key, value in lists.items()), "}"])
