"""Robots by name: those of this package and of others, found by their entry points."""

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from functools import partial
from os import environ
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.robots.robot import Robot, Simulation

ROBOTS_GROUP = "stepgap.robots"
"""Entry points of this group are classes: frozen dataclasses, subclasses of `Robot`."""

SIMULATIONS = "stepgap.simulations"
"""Entry points of this group, with names ROBOT.PLANT, are callables (robot, generator of the world) → `Simulation`."""


def robot_names() -> tuple[str, ...]:
    """Names of all installed robots, in alphabetical order."""
    return plugin_names(ROBOTS_GROUP)


def load_robot(name: str) -> Robot:
    """The robot of this name with default settings.

    Raises:
        InputError: There is no such robot, a package that it needs is not installed, or it is not a robot.
    """
    if name not in robot_names() and (hint := _hint_of_folder(name)):
        raise InputError(f"robot '{name}': not installed, but there is a folder {name}; {hint}")
    description = f"a subclass of stepgap.Robot that is a dataclass and has name = '{name}'"
    kind = load_plugin(ROBOTS_GROUP, "robot", name, lambda plugin: _is_robot(plugin, name), description)
    try:
        robot = kind()
    except (TypeError, ValueError) as error:
        raise InputError(f"robot '{name}': cannot be made with default settings: {error}") from None
    for entry in fields(robot):
        if not is_dataclass(getattr(robot, entry.name)):
            raise InputError(f"robot '{name}': its field {entry.name} is no table; it must be a frozen dataclass")
    return robot


def simulations_of(robot: Robot) -> Mapping[str, Callable[[np.random.Generator], Simulation]]:
    """The simulated plants of a robot by name: its own, and those that plug-ins add; the first one is the default."""

    def made(name: str, world: np.random.Generator) -> Simulation:
        make = load_plugin(SIMULATIONS, "simulated plant", name, callable, "callable with (robot, world)")
        return make(robot, world)

    prefix = f"{robot.name}."
    added = (name for name in plugin_names(SIMULATIONS) if name.startswith(prefix))
    return {**robot.simulations(), **{name.removeprefix(prefix): partial(made, name) for name in added}}


def next_commands(folder: Path) -> tuple[str, ...]:
    """The commands that run the robot in a folder made by `stepgap new`; none in another folder.

    They are as they must be typed: through `./go`, if that started this process.
    """
    stepgap = "stepgap"
    install = "pip install -e"
    if go := environ.get("STEPGAP_GO"):
        stepgap = f"{quote(go)} stepgap"
        install = f"{quote(go)} uv pip install -e"
    run = f"{stepgap} run {quote(str(folder / 'experiment.toml'))}"
    if not (folder / "experiment.toml").is_file():
        return ()
    if (folder / "pyproject.toml").is_file():
        return f"{install} {quote(str(folder))}", run
    if (folder / "robot.py").is_file():
        return (f"{run} -- python3 {quote(str(folder / 'robot.py'))}",)
    return (run,)


def _hint_of_folder(name: str) -> str:
    """How to run the robot in a folder of this name; empty if there is none."""
    commands = next_commands(Path(name)) if Path(name).is_dir() else ()
    return f"run it by: {' && '.join(commands)}" if commands else ""


def _is_robot(plugin: Any, name: str) -> bool:
    """Whether an object is a class of robots with this name."""
    is_class = isinstance(plugin, type) and issubclass(plugin, Robot) and is_dataclass(plugin)
    return is_class and getattr(plugin, "name", None) == name
