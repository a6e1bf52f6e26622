"""Settings of an experiment: read with strict checks from TOML and the command line, written with all values."""

import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from operator import attrgetter
from pathlib import Path
from typing import Any, TypeVar, cast

import tomli_w

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import write_whole
from stepgap.base.ranges import format_value, require
from stepgap.base.settings_file import (
    IS_KEY,
    LARGEST_SETTINGS_FILE,
    Locate,
    located,
    merge_all,
    parse_toml,
    read_toml,
    to_table,
    with_table,
)
from stepgap.control.reference import Reference, read_reference, reference_text
from stepgap.control.settings import ControlSettings
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import StepLog, joined
from stepgap.plants.process.process_plant import Timeouts
from stepgap.records.steps_csv import RecordError, read_step_log, space_of_header, text_of
from stepgap.robots.entry_points import load_robot, robot_names
from stepgap.robots.robot import Robot
from stepgap.step import StepSpace

_Choice = TypeVar("_Choice")

ROBOT = "robot"
"""Key of the robot's name."""

DEFAULT_ROBOT = "hopper"
"""Name of the robot if no other is given."""

PATHS = ("reference", "rig", "warm_start", "nominal.file")
"""Settings that name a file or a folder."""

PROCESS = "process"
"""The plant that is another program; all others but the simulated ones are names of rigs."""

FROM_TEMPLATE, FROM_LOG = "template", "log"
"""Kinds of nominal map that every robot has, each with a file."""

SURROGATE = "nominal_map.json"
"""File in a run's folder with the surrogate of a simulator."""

WARM_START = "warm_start.csv"
"""File in a run's folder with the steps that were known before its first deployment."""

PAPER_LEARNING = LearningSettings(
    residual="fitrgp", early_stop=False, drift=False, remove_yaw_dependence=False, monitor=False
)
PAPER_CONTROL = ControlSettings(cautious=False, viability=False, avoid_failures=False)
METHODS: Mapping[str, tuple[LearningSettings, ControlSettings]] = {
    "default": (LearningSettings(), ControlSettings()),
    "paper": (PAPER_LEARNING, PAPER_CONTROL),
}
"""Values of `method`, which sets the tables `[learning]` and `[control]` before single keys change some settings.

`paper` is the method as published: MATLAB's `fitrgp`, Eq. 13 without further rules, four redeployments.
"""

SHORT_OPTIONS = {
    "learning.iterations": "iterations",
    "learning.exploration": "explore",
    "learning.online": "online",
    "warm_start": "warm-start",
}
"""Names of the options that differ from the names of their settings."""


@dataclass(frozen=True)
class NominalSettings:
    """Which nominal map is corrected.

    Attributes:
        kind: One of the robot's maps, such as equations; template: a step and rough derivatives from `file`; log:
            fitted to the steps in `file`. Empty: the first one of the robot.
        file: A template (TOML), the steps of a log (a `steps.csv`), or the surrogate of a simulator as a run stores it,
            relative to the experiment's file.
    """

    kind: str = ""
    file: str = ""


def _hopper() -> Robot:
    return load_robot(DEFAULT_ROBOT)


@dataclass(frozen=True)
class Experiment:
    """All settings of an experiment; the names are those of the TOML file.

    In the file, `robot` is the name of the robot, and the tables of the robot stand beside those of the experiment.

    Attributes:
        robot: Robot with its settings.
        seed: Random seed.
        reference: Name of a reference of the robot, or a CSV file of targets, relative to the experiment's file.
            Empty: the first one of the robot.
        plant: A simulated plant of the robot, `process` (another program), or the name of a rig. Empty: the first
            simulated one.
        rig: File that describes that rig, relative to the experiment's file.
        warm_start: Folder of a run whose steps are known before the first deployment, or a `steps.csv`, relative to the
            experiment's file; empty: nothing is known.
        nominal: Nominal map.
        learning: Settings of learning.
        control: Settings of step control.
        process: Longest times to wait for the program of the plant `process`.
    """

    robot: Robot = field(default_factory=_hopper, metadata={IS_KEY: False})
    seed: int = 0
    reference: str = ""
    plant: str = ""
    rig: str = ""
    warm_start: str = ""
    nominal: NominalSettings = field(default_factory=NominalSettings)
    learning: LearningSettings = field(default_factory=LearningSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    process: Timeouts = field(default_factory=Timeouts)

    def __post_init__(self) -> None:
        require(0 <= self.seed < 2**63, "seed", self.seed, "lie between 0 and 2⁶³")
        object.__setattr__(self, "reference", self.reference or next(iter(self.robot.references())))
        object.__setattr__(self, "plant", self.plant or next(iter(self.robot.simulations()), PROCESS))
        kind = self.nominal.kind or next(iter(self.robot.nominal_maps()), FROM_TEMPLATE)
        object.__setattr__(self, "nominal", replace(self.nominal, kind=kind))

    @property
    def simulated(self) -> bool:
        """Whether the plant is simulated, so that a deployment can be repeated."""
        return self.plant in self.robot.simulations()


def read_experiment(path: Path | None, overrides: Iterable[tuple[str, str]] = ()) -> Experiment:
    """Reads the experiment of a file, with single settings overridden.

    Args:
        path: TOML file; None for the defaults.
        overrides: Dotted name and value as TOML, such as ("gains.stiffness", "2400").

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    overrides = [(name.replace("-", "_"), _parse_value(value)) for name, value in overrides]
    chosen = dict(overrides).get(ROBOT)
    experiment = Experiment() if chosen is None else Experiment(_robot(chosen, f"--{ROBOT}"))
    if path is not None:
        table = read_toml(path, "an experiment")
        if chosen is not None and table.get(ROBOT, chosen) != chosen:
            raise InputError(f"--{ROBOT} {chosen}: {path} is an experiment of robot = {format_value(table[ROBOT])}")
        experiment = changed_experiment(experiment, table, lambda name: f"{path}: {with_table(name)}")
        experiment = with_absolute_paths(experiment, path.parent)
    changes = nested((name, value) for name, value in overrides if name != ROBOT)
    return changed_experiment(experiment, changes, lambda name: f"--{SHORT_OPTIONS.get(name, name)}")


def with_absolute_paths(experiment: Experiment, folder: Path) -> Experiment:
    """The experiment from a file in this folder, to which its paths are relative."""
    given = {name: attrgetter(name)(experiment) for name in PATHS}
    found = {name: in_folder(folder, experiment.robot, name, value) for name, value in given.items()}
    nominal = replace(experiment.nominal, file=found.pop("nominal.file"))
    return replace(experiment, **found, nominal=nominal)


def in_folder(folder: Path, robot: Robot, name: str, value: str) -> str:
    """The value of a setting in `PATHS` that is given in a file of this folder, relative to which paths are."""
    named = bool(value) and not (name == "reference" and value in robot.references())
    return str(folder / value) if named else value


def load_reference(experiment: Experiment, space: StepSpace) -> Reference:
    """Reads the reference to track.

    Raises:
        InputError: The file does not exist or is not a reference.
    """
    built_in = experiment.robot.references()
    if experiment.reference in built_in:
        return built_in[experiment.reference]()
    names = " or ".join(f"'{name}'" for name in built_in)
    path, wanted = Path(experiment.reference), f"reference must be {names} or a CSV file of targets"
    try:
        if path.stat().st_size > LARGEST_SETTINGS_FILE:
            raise InputError(f"{path}: larger than {LARGEST_SETTINGS_FILE} bytes; {wanted}")
        return read_reference(path, space)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; {wanted}") from None
    except csv.Error as error:
        raise InputError(f"{path}: {error}; {wanted}") from None
    except ValueError as error:
        raise InputError(str(error)) from None


def load_known(experiment: Experiment, space: StepSpace) -> StepLog:
    """Reads the steps known before the first deployment: those of the run to start from, and those it started from.

    Raises:
        InputError: It is not a run, has another state or command, or has no step.
    """
    if not experiment.warm_start:
        return StepLog(space)
    path, wanted = Path(experiment.warm_start), "a warm start needs the folder of a run, or its steps.csv"
    earlier = [path / WARM_START] if (path / WARM_START).is_file() else []
    files = [*earlier, path / "steps.csv"] if path.is_dir() else [path]
    try:
        known = joined([read_step_log(file, space) for file in files])
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror}; {wanted}") from None
    except RecordError as error:
        raise InputError(f"{error}; {wanted}, of the same state and command") from None
    if not len(known):
        raise InputError(f"{files[-1]}: no step yet; {wanted} with at least one step")
    return known


def recorded_space(folder: Path) -> StepSpace | None:
    """State and command of the robot of a run, with units and ranges.

    None if its settings are not known, or are not those of its steps; then only the names in `steps.csv` are known.
    """
    try:
        space, found = read_experiment(folder / "experiment.toml").robot.space, space_of_header(folder / "steps.csv")
    except (InputError, ValueError, OSError):
        return None
    same = (space.state_names, space.command_names) == (found.state_names, found.command_names)
    return space if same else None


def experiment_files(
    experiment: Experiment, reference: Reference, known: StepLog | None = None, surrogate: str = ""
) -> dict[str, str]:
    """Texts by file name of a folder with which an experiment can be repeated: all settings are in `experiment.toml`.

    A reference, a nominal map and earlier steps from files are among the files, so that the folder is complete. The
    file of a rig is not: it belongs to the machine on which it was checked.

    Args:
        experiment: The experiment.
        reference: Its reference.
        known: Steps that are known before the first deployment.
        surrogate: Text of the file of its nominal map, if that was fitted for it.

    Raises:
        InputError: The file of the nominal map cannot be read.
    """
    files = {}
    if experiment.rig:
        experiment = replace(experiment, rig=str(Path(experiment.rig).resolve()))
    if experiment.reference not in experiment.robot.references():
        files["reference.csv"] = reference_text(reference)
        experiment = replace(experiment, reference="reference.csv")
    if experiment.nominal.file or surrogate:
        path = Path(experiment.nominal.file or SURROGATE)
        name = f"nominal_map{path.suffix}"
        files[name] = surrogate or _text_of(path)
        experiment = replace(experiment, nominal=replace(experiment.nominal, file=name))
    if known:
        files[WARM_START] = text_of(known)
        experiment = replace(experiment, warm_start=WARM_START)
    return {**files, "experiment.toml": tomli_w.dumps(experiment_table(experiment))}


def experiment_table(experiment: Experiment) -> dict[str, Any]:
    """The experiment as the table of its TOML file."""
    return {ROBOT: experiment.robot.name, **to_table(experiment), **to_table(experiment.robot)}


def write_experiment(
    folder: Path, experiment: Experiment, reference: Reference, known: StepLog | None = None, surrogate: str = ""
) -> None:
    """Writes the files of `experiment_files`."""
    for name, text in experiment_files(experiment, reference, known, surrogate).items():
        write_whole(folder / name, text)


def _text_of(path: Path) -> str:
    try:
        return path.read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"nominal.file: {message_of(error)}") from None


def _parse_value(text: str) -> Any:
    """The TOML value that `text` represents; a word without quotes is a string."""
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if len(table) == 1 else text


def nested(entries: Iterable[tuple[str, Any]]) -> dict[str, Any]:
    """The nested tables of entries with dotted names."""
    tables: dict[str, Any] = {}
    for name, value in entries:
        *outer, last = name.split(".")
        table = tables
        for key in outer:
            inner = table.get(key)
            table[key] = inner if isinstance(inner, dict) else {}
            table = table[key]
        table[last] = value
    return tables


def changed_experiment(experiment: Experiment, table: Mapping[str, Any], locate: Locate) -> Experiment:
    """The experiment with the values of a TOML table.

    Raises:
        InputError: A setting is wrong, or settings do not fit together; messages name a key by `locate`.
    """
    experiment = merged_experiment(experiment, table, locate)
    try:
        experiment.robot.check()
    except ValueError as error:
        raise located(error, locate, "") from None
    if experiment.control.table and (experiment.learning.drift or experiment.learning.online):
        raise InputError(
            f"{locate('control.table')} = {experiment.control.table}, but a table does not change during a deployment; "
            "also set learning.drift = false and learning.online = false, as --method paper does"
        )
    return experiment


def merged_experiment(experiment: Experiment, table: Mapping[str, Any], locate: Locate) -> Experiment:
    """As `changed_experiment`, but without the check whether settings of different tables fit together."""
    rest = dict(table)
    if ROBOT in rest:
        robot = _robot(rest.pop(ROBOT), locate(ROBOT))
        if type(robot) is not type(experiment.robot):
            experiment = Experiment(robot, experiment.seed)
    if "method" in rest:
        learning, control = _chosen(METHODS, rest.pop("method"), locate("method"))
        experiment = replace(experiment, learning=learning, control=control)
    robot = experiment.robot
    for name, presets in robot.presets.items():
        part = rest.get(name)
        if isinstance(part, Mapping) and "preset" in part:
            preset = _chosen(presets, part["preset"], locate(f"{name}.preset"))
            robot = replace(cast("Any", robot), **{name: preset})
            rest[name] = {key: value for key, value in part.items() if key != "preset"}
    more = (ROBOT, "method", *(f"{name}.preset" for name in robot.presets))
    experiment, robot = merge_all((experiment, robot), rest, locate, more=more)
    return replace(experiment, robot=robot)


def _robot(name: Any, where: str) -> Robot:
    """The robot of this name; `where` names the setting in messages."""
    if isinstance(name, Mapping):
        names = f"{ROBOT} = '{DEFAULT_ROBOT}' names the robot"
        raise InputError(f"{where}: this table is called [parameters] now; {names}")
    if not isinstance(name, str):
        raise InputError(f"{where} = {format_value(name)}, but it must be one of {', '.join(robot_names())}")
    return load_robot(name)


def _chosen(choices: Mapping[str, _Choice], name: Any, where: str) -> _Choice:
    """The choice of this name; `where` names the setting in the message of the InputError if there is none."""
    if name in list(choices):
        return choices[name]
    close = get_close_matches(str(name), choices, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    wanted = " or ".join(f"'{known}'" for known in choices)
    raise InputError(f"{where} = {format_value(name)}, but it must be {wanted}{hint}")
