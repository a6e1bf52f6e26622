"""The folders of robots in Python that `stepgap new` makes."""

import keyword
import re
from collections.abc import Sequence
from importlib.resources import files
from importlib.util import find_spec
from pathlib import Path
from string import Template
from typing import NamedTuple

from stepgap.base.errors import InputError
from stepgap.base.files import create


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
PACKAGE_NAME = "[A-Za-z]([A-Za-z0-9_]*[A-Za-z0-9])?"
"""Names that are valid for a module, a project and a key of TOML."""
NAMED_CLASS = re.compile(r'^class \w+\((\w*Robot)\):\n    name = ".*"$', re.MULTILINE)
"""The lines of a module that name its robot."""


def starter_text(name: str, package: str = "stepgap.cli") -> str:
    """Text of a file among the starters of a package."""
    return files(package).joinpath("starters", name).read_text("utf-8")


def readme_name(name: str) -> str:
    """A name as Markdown."""
    return re.sub(r"([^\w ])", r"\\\1", name)


def check_package_name(name: str) -> None:
    """Raises InputError unless a new robot in Python may have this name."""
    from stepgap.robots.entry_points import robot_names

    wrong = ""
    if not re.fullmatch("[A-Za-z0-9_]*", name):
        wrong = "it must have only letters from a to z, digits and underscores"
    elif not re.fullmatch(PACKAGE_NAME, name):
        wrong = "a letter must be first, and no underscore last"
    elif keyword.iskeyword(name):
        wrong = "it is a word of Python"
    elif name in robot_names():
        wrong = "a robot that is installed here has it"
    elif find_spec(name):
        wrong = "a module that is installed here has it"
    if wrong:
        raise InputError(f"{name}: not the name of a new Python module: {wrong}; choose another")


def write_package(folder: Path, name: str, starter: Starter) -> None:
    """Writes the files of a robot that begins with a starter of this package."""
    text = starter_text(starter.file)
    class_ = class_name(name, text)
    code = NAMED_CLASS.sub(rf'class {class_}(\1):\n    name = "{name}"', text)
    write_robot(folder, name, starter, class_, code)


def write_robot(folder: Path, name: str, starter: Starter, class_: str, code: str, copied: Sequence[str] = ()) -> None:
    """Writes the files of a robot.

    Args:
        folder: A folder without these files.
        name: Name of the robot.
        starter: What it begins with.
        class_: Name of its class.
        code: Its module.
        copied: Files and folders beside the module that belong to it.
    """
    values = {
        "name": name,
        "package": name.replace("_", "-"),
        "class": class_,
        "model": "".join(f', "{file}"' for file in copied),
    }
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


def class_name(name: str, code: str) -> str:
    """Name of the class of a robot, such as `MyRobot` of my_robot; with Robot at its end if its module uses that."""
    class_name = "".join(word[:1].upper() + word[1:] for word in name.split("_"))
    others = {*re.findall(r"\w+", NAMED_CLASS.sub(r"\1", code)), "True", "False", "None"}
    while class_name in others:
        class_name += "Robot"
    return class_name
