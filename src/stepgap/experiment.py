"""Every setting of an experiment: read strictly from TOML and the command line, written back resolved."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, fields, is_dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, get_type_hints

import tomli_w

from stepgap.control.reference import Reference, paper_reference, read_reference
from stepgap.hopper.joint_control import joint_law
from stepgap.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.rigs.twin.reality_gap import RealityGap
from stepgap.sim_to_real import LearningSettings, write_whole
from stepgap.step import StepSpace

LARGEST_FILE = 2**20
"""Largest experiment file that is read [bytes]."""

PAPER = "paper"
"""Name of the built-in reference."""


class InputError(ValueError):
    """Something the user gave is wrong; the message is one line that says what would be right."""


@dataclass(frozen=True)
class Experiment:
    """All settings; the names are those of the TOML file.

    Attributes:
        seed: Of all randomness.
        reference: `paper`, or a CSV file of targets, relative to the experiment's file.
        robot: The robot as the physics model takes it.
        gains: Joint controller.
        command: Bounds of the step command.
        learning: How often is learnt, and what.
        gap: How the twin differs from the model.
    """

    seed: int = 0
    reference: str = PAPER
    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    command: CommandBounds = field(default_factory=CommandBounds)
    learning: LearningSettings = field(default_factory=LearningSettings)
    gap: RealityGap = field(default_factory=RealityGap)

    def __post_init__(self) -> None:
        if not 0 <= self.seed < 2**63:
            raise ValueError(f"seed = {self.seed}, but it must lie between 0 and 2⁶³")


def read_experiment(path: Path | None, overrides: Iterable[tuple[str, str]] = ()) -> Experiment:
    """The experiment of a file with single settings overridden.

    Args:
        path: TOML file; None for the defaults.
        overrides: Dotted name and value as TOML, such as ("gains.stiffness", "2400").

    Raises:
        InputError: Naming file, key and what would be right.
    """
    experiment = Experiment()
    if path is not None:
        experiment = _merge(experiment, _read_toml(path), str(path))
        if experiment.reference != PAPER:
            experiment = replace(experiment, reference=str(path.parent / experiment.reference))
    for name, value in overrides:
        table: Any = _parse_value(value)
        for key in reversed(name.replace("-", "_").split(".")):
            table = {key: table}
        experiment = _merge(experiment, table, f"--{name}")
    source = str(path) if path else "settings"
    try:
        joint_law(experiment.robot, experiment.gains)
    except ValueError as error:
        raise InputError(f"{source}: [gains] {error}") from None
    return experiment


def load_reference(experiment: Experiment, space: StepSpace) -> Reference:
    """The targets to track.

    Raises:
        InputError: The file is missing or is not a reference.
    """
    if experiment.reference == PAPER:
        return paper_reference()
    try:
        return read_reference(experiment.reference, space)
    except OSError as error:
        raise InputError(
            f"{experiment.reference}: {error.strerror}; reference must be '{PAPER}' or a CSV file of targets"
        ) from None
    except ValueError as error:
        raise InputError(str(error)) from None


def write_experiment(folder: Path, experiment: Experiment, reference: Reference) -> None:
    """Writes every setting to `experiment.toml`, so that the file reruns the experiment.

    A reference from a file is copied into the folder, so that the folder is complete.
    """
    if experiment.reference != PAPER:
        rows = [",".join(reference.names), *(",".join(map(repr, target)) for target in reference.targets.tolist())]
        write_whole(folder / "reference.csv", "\n".join(rows) + "\n")
        experiment = replace(experiment, reference="reference.csv")
    write_whole(folder / "experiment.toml", tomli_w.dumps(asdict(experiment)))


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > LARGEST_FILE:
            raise InputError(f"{path}: larger than {LARGEST_FILE} bytes, so it is no experiment file")
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; give an existing TOML file") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: this is not text; an experiment is a TOML file in UTF-8") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"{path}: not TOML: {error}") from None


def _parse_value(text: str) -> Any:
    """The TOML value that `text` spells; a bare word is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (tomllib.TOMLDecodeError, KeyError):
        return text


def _merge(settings: Any, table: Mapping[str, Any], source: str, section: str = "") -> Any:
    """The dataclass `settings` with the values of a TOML table, checked for names and types."""
    types = get_type_hints(type(settings))
    known = [entry.name for entry in fields(settings)]
    changes: dict[str, Any] = {}
    for key, value in table.items():
        place = f"{source}: {section}{key}"
        if key not in types or key not in known:
            close = get_close_matches(key, known, n=1)
            hint = f"did you mean {close[0]}?" if close else f"the keys here are {', '.join(known)}"
            raise InputError(f"{place}: unknown key; {hint}")
        current = getattr(settings, key)
        if is_dataclass(current):
            if not isinstance(value, Mapping):
                raise InputError(f"{place} = {value!r}, but it must be a table")
            changes[key] = _merge(current, value, source, f"[{key}] ")
        else:
            changes[key] = _as_type(value, types[key], place)
    try:
        return replace(settings, **changes)
    except InputError:
        raise
    except ValueError as error:
        raise InputError(f"{source}: {section}{error}") from None


def _as_type(value: Any, wanted: type, place: str) -> Any:
    """The value, if it has the type of the field; a whole number may stand for a number."""
    if wanted is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if type(value) is not wanted:
        words = {float: "a number", int: "a whole number", bool: "true or false", str: "a text in quotes"}
        raise InputError(f"{place} = {value!r}, but it must be {words[wanted]}")
    return value
