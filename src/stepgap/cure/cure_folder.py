"""The folder that `stepgap cure` writes: page, passport, the corrector in Python, C and as a node of ROS 2."""

import json
from datetime import UTC, datetime
from hashlib import sha256
from importlib.resources import files
from pathlib import Path
from typing import Any, Final

import numpy as np

from stepgap.base.normal import std_interval_95
from stepgap.base.settings_file import toml_line
from stepgap.base.versions import versions_here
from stepgap.cure.cure_page import HOLD_SECONDS, UNITS, cure_page
from stepgap.cure.drive import AXIS_NAMES
from stepgap.cure.habits import Habit, commands_to_drive, stands_at_zero
from stepgap.cure.lesson import MOST_CHANGE, MOST_SURPRISE, Lesson
from stepgap.export.controller.c_source import c_source
from stepgap.export.controller.model_document import model_text
from stepgap.export.controller.passport import checked_robot_name, passport_lines
from stepgap.export.controller.portable_controller import portable_form
from stepgap.export.controller.python_source import python_source
from stepgap.logs.foreign_log import as_deployments
from stepgap.records.steps_csv import text_of

_PACKAGE: Final = "stepgap.cure"
_STALE: Final = (0.2, 5.0)  # Odometry is stale after this time [s], or after this number of its usual intervals
_FROZEN: Final = (0.3, 8.0)  # The same for numbers that repeat
_JUMP: Final = (0.3, 4.0)
"""A velocity jumps if it changes by this [m/s, rad/s], and by this many times the 99.9 % quantile of changes."""
_UNDRIVEN_LIMIT: Final = 0.5  # Limit of a command that was not driven, so that it is passed on [m/s, rad/s]
_STAMPED: Final = "geometry_msgs/TwistStamped"
_POSE: Final = "geometry_msgs/PoseStamped"


def cure_passport(lesson: Lesson, name: str, settings: str) -> dict[str, Any]:
    """The passport of a robot that was driven by hand; its keys are those of a run's.

    Raises:
        InputError: The name is too long, or cannot be printed.
    """
    before, after = lesson.held.rms(held=True)
    count = max(int(np.count_nonzero(~lesson.held.first)), 1)
    ends = std_interval_95(after, count)
    last = datetime.fromtimestamp(lesson.drive.time[-1], UTC) if lesson.drive.time[-1] > 1e9 else datetime.now(UTC)
    return {
        "robot": "velocity",
        "name": checked_robot_name(name),
        "plant": "log",
        "date": f"{last:%Y-%m-%d}",
        "deployments": len(lesson.drives),
        "steps": len(lesson.steps),
        "errors": [
            {
                "state": AXIS_NAMES[axis],
                "unit": UNITS[axis],
                "before": float(before[axis]),
                "after": float(after[axis]),
                "after_interval": ends[:, axis].tolist(),
            }
            for axis in np.flatnonzero(lesson.driven).tolist()
        ],
        "settings_sha256": sha256(settings.encode()).hexdigest(),
        "versions": versions_here(),
    }


def cure_files(lesson: Lesson, habits: list[Habit], checks: list[str], name: str) -> dict[str, str]:
    """Contents of the files by name.

    Args:
        lesson: What was learned.
        habits: What the robot does with which command.
        checks: Sentences on the odometry.
        name: Name of the robot in its passport.

    Raises:
        InputError: The name cannot be used.
    """
    settings = _experiment(lesson)
    passport = cure_passport(lesson, name, settings)
    rng = np.random.default_rng(0)
    controller = portable_form(lesson.learner, lesson.control, rng, passport, lesson.drive.log.source)
    source = c_source(controller, "controller")
    return {
        "index.html": cure_page(lesson, habits, checks, passport_lines(passport)),
        "passport.json": json.dumps(passport, indent=1, ensure_ascii=False) + "\n",
        "model.json": model_text(controller),
        "controller.py": python_source(controller),
        "controller.c": source.code,
        "controller.h": source.header,
        "velocity_filter.py": files(_PACKAGE).joinpath("velocity_filter.py").read_text("utf-8"),
        "cmd_vel_correction.py": _template("cmd_vel_correction.py.txt", {"DEFAULTS": _defaults(lesson)}),
        "correction.launch.py": _template("correction.launch.py.txt", {"STAMPED": str(_stamped(lesson)).lower()}),
        "experiment.toml": settings,
        "steps.csv": text_of(as_deployments(lesson.steps)),
        "next_commands.csv": _next_commands(lesson),
    }


def _template(name: str, parts: dict[str, str]) -> str:
    text = files(_PACKAGE).joinpath("files", name).read_text("utf-8")
    for key, part in parts.items():
        text = text.replace(f"@{key}@", part)
    return text


def _stamped(lesson: Lesson) -> bool:
    """Whether the log has stamped commands; without a type in the log, as is usual since ROS 2 Jazzy."""
    kind = lesson.drive.command.kind
    return kind == _STAMPED or not kind.startswith("geometry_msgs")


def filter_numbers(lesson: Lesson) -> dict[str, Any]:
    """The settings of the velocity filter that follow from the log, as keywords of `FilterSettings`."""
    drive = lesson.drive
    space = lesson.space
    ends = np.maximum(np.abs(space.command_lower), np.abs(space.command_upper))
    limits = np.where(lesson.driven, ends, _UNDRIVEN_LIMIT)
    changes = np.quantile(np.abs(np.diff(drive.velocity, axis=0)), 0.999, axis=0)
    jump = np.maximum(_JUMP[0], _JUMP[1] * changes)
    return {
        "seconds": lesson.walk.seconds,
        "limits": tuple(round(float(limit), 4) for limit in limits),
        "axes": tuple(bool(driven) for driven in lesson.driven),
        "stale": round(max(_STALE[0], _STALE[1] * drive.interval), 3),
        "frozen": round(max(_FROZEN[0], _FROZEN[1] * drive.interval), 3),
        "jump": tuple(round(float(most), 3) for most in jump),
        "zero": stands_at_zero(lesson),
    }


def _defaults(lesson: Lesson) -> str:
    """Python of the constants of the node: numbers and truth values alone."""
    numbers = filter_numbers(lesson)
    meaning = {
        "enabled": (True, "false: commands are passed on as they are, within the limits"),
        "stamped": (_stamped(lesson), "whether commands are TwistStamped; false for Twist"),
        "frame": ("base_link", "frame of stamped commands"),
        "pose": (lesson.drive.measured.kind == _POSE, "whether odom has PoseStamped; false for Odometry"),
        "seconds": (numbers["seconds"], "duration of a step [s]; belongs to what was learned"),
        "stale": (numbers["stale"], "odometry that is older does not count [s]"),
        "frozen": (numbers["frozen"], "nor such that repeats the same numbers for longer [s]"),
        "zero": (numbers["zero"], "whether the command zero is passed on: the robot stands then"),
        "learns": (True, "whether it goes on learning"),
        "make_up": (0.0, "time in which heading and place beside the way are made up for [s]; 0: they are not"),
        "in_world": (lesson.drive.is_turned, "whether the velocities of the odometry are in the frame of the world"),
    }
    for name, limit in zip(AXIS_NAMES, numbers["limits"], strict=True):
        meaning[f"limit_{name}"] = (limit, "largest command, of either sign; can be made smaller")
    lines = [f'    "{key}": {_as_python(value)},  # {text}' for key, (value, text) in meaning.items()]
    axes = f"AXES = {numbers['axes']!r}  # which velocities are corrected"
    jump = f"JUMP = {numbers['jump']!r}  # a larger change from sample to sample is no motion of the robot"
    return "\n".join(["DEFAULTS = {", *lines, "}", axes, jump])


def _as_python(value: bool | float | str) -> str:
    """A truth value, a number or a plain word as Python."""
    return f'"{value}"' if isinstance(value, str) else repr(value)


def _experiment(lesson: Lesson) -> str:
    """Settings with which a run goes on from the log."""
    walk = lesson.walk
    rules = [toml_line("largest_change", MOST_CHANGE), toml_line("surprise", MOST_SURPRISE)]
    lines = ['robot = "velocity"', 'plant = "process"', "", "[control]", *rules]
    lines += ["", "[walk]", *(toml_line(key, getattr(walk, key)) for key in ("seconds", "time_constant"))]
    for name in AXIS_NAMES:
        lines += ["", f"[walk.{name}]", *(toml_line(key, value) for key, value in vars(getattr(walk, name)).items())]
    return "\n".join([*lines, ""])


def _next_commands(lesson: Lesson) -> str:
    rows = [
        f"{HOLD_SECONDS:g},{','.join(f'{value:.2f}' for value in row)}" for row in commands_to_drive(lesson).tolist()
    ]
    return "\n".join(["seconds,command_vx,command_vy,command_wz", *rows, ""])


def name_of_log(path: str) -> str:
    """A name for the robot of a log: that of its first file."""
    stem = Path(path.split("+")[0].strip()).name
    return "".join(letter if letter.isprintable() else "_" for letter in stem)[:60]
