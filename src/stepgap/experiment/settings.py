"""Settings of an experiment: read with strict checks from TOML and the command line, written with all values."""

import csv
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import tomli_w

from stepgap.base.errors import InputError
from stepgap.base.files import write_whole
from stepgap.base.ranges import format_value, require
from stepgap.base.settings_file import (
    LARGEST_SETTINGS_FILE,
    Locate,
    located,
    merge,
    parse_toml,
    read_toml,
    to_table,
    with_table,
)
from stepgap.control.reference import Reference, paper_reference, read_reference, reference_text
from stepgap.control.settings import ControlSettings
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import StepLog, joined
from stepgap.plants.process.process_plant import Timeouts
from stepgap.records.steps_csv import RecordError, read_step_log, text_of
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import StepSpace

_Choice = TypeVar("_Choice")

PAPER = "paper"
"""Name of the built-in reference."""

PATHS = ("reference", "rig", "warm_start")
"""Settings that name a file or a folder."""

TWIN, EMULATED_RING = "twin", "emulated-ring"
"""Simulated plants."""

PROCESS = "process"
"""The plant that is another program; all others but the simulated ones are names of rigs."""

WARM_START = "warm_start.csv"
"""File in a run's folder with the steps that were known before its first deployment."""

PRESETS: Mapping[str, Callable[[], RealityGap]] = {"paper": RealityGap, "none": RealityGap.none}
"""Values of `[gap] preset`; a preset sets all differences before single keys change some of them."""

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
class Experiment:
    """All settings of an experiment; the names are those of the TOML file.

    Attributes:
        seed: Random seed.
        reference: `paper`, or a CSV file of targets, relative to the experiment's file.
        plant: `twin`, `emulated-ring` (the twin on an EtherCAT bus in software), `process` (another program), or the
            name of a rig.
        rig: File that describes that rig, relative to the experiment's file.
        warm_start: Folder of a run whose steps are known before the first deployment, or a `steps.csv`, relative to the
            experiment's file; empty: nothing is known.
        robot: Robot of the physics model.
        gains: Gains of the joint controller.
        command: Bounds of the step command.
        learning: Settings of learning.
        control: Settings of step control.
        gap: Differences of the twin from the model.
        process: Longest times to wait for the program of the plant `process`.
    """

    seed: int = 0
    reference: str = PAPER
    plant: str = TWIN
    rig: str = ""
    warm_start: str = ""
    robot: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    command: CommandBounds = field(default_factory=CommandBounds)
    learning: LearningSettings = field(default_factory=LearningSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    gap: RealityGap = field(default_factory=RealityGap)
    process: Timeouts = field(default_factory=Timeouts)

    def __post_init__(self) -> None:
        require(0 <= self.seed < 2**63, "seed", self.seed, "lie between 0 and 2⁶³")


def read_experiment(path: Path | None, overrides: Iterable[tuple[str, str]] = ()) -> Experiment:
    """Reads the experiment of a file, with single settings overridden.

    Args:
        path: TOML file; None for the defaults.
        overrides: Dotted name and value as TOML, such as ("gains.stiffness", "2400").

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    experiment = Experiment()
    if path is not None:
        table = read_toml(path, "an experiment")
        experiment = changed_experiment(experiment, table, lambda name: f"{path}: {with_table(name)}")
        paths = {name: in_folder(path.parent, name, getattr(experiment, name)) for name in PATHS}
        experiment = replace(experiment, **paths)
    changes = nested((name.replace("-", "_"), _parse_value(value)) for name, value in overrides)
    return changed_experiment(experiment, changes, lambda name: f"--{SHORT_OPTIONS.get(name, name)}")


def in_folder(folder: Path, name: str, value: str) -> str:
    """The value of a setting in `PATHS` that is given in a file of this folder, relative to which paths are."""
    named = bool(value) and not (name == "reference" and value == PAPER)
    return str(folder / value) if named else value


def load_reference(experiment: Experiment, space: StepSpace) -> Reference:
    """Reads the reference to track.

    Raises:
        InputError: The file does not exist or is not a reference.
    """
    if experiment.reference == PAPER:
        return paper_reference()
    path, wanted = Path(experiment.reference), f"reference must be '{PAPER}' or a CSV file of targets"
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


def experiment_files(experiment: Experiment, reference: Reference, known: StepLog | None = None) -> dict[str, str]:
    """Texts by file name of a folder with which an experiment can be repeated: all settings are in `experiment.toml`.

    A reference from a file and earlier steps are among the files, so that the folder is complete. The file of a rig is
    not: it belongs to the machine on which it was checked.
    """
    files = {}
    if experiment.rig:
        experiment = replace(experiment, rig=str(Path(experiment.rig).resolve()))
    if experiment.reference != PAPER:
        files["reference.csv"] = reference_text(reference)
        experiment = replace(experiment, reference="reference.csv")
    if known:
        files[WARM_START] = text_of(known)
        experiment = replace(experiment, warm_start=WARM_START)
    return {**files, "experiment.toml": tomli_w.dumps(to_table(experiment))}


def write_experiment(folder: Path, experiment: Experiment, reference: Reference, known: StepLog | None = None) -> None:
    """Writes the files of `experiment_files`."""
    for name, text in experiment_files(experiment, reference, known).items():
        write_whole(folder / name, text)


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
        experiment.gains.check(experiment.robot)
    except ValueError as error:
        raise located(error, locate, "gains.") from None
    if experiment.control.table and (experiment.learning.drift or experiment.learning.online):
        raise InputError(
            f"{locate('control.table')} = {experiment.control.table}, but a table does not change during a deployment; "
            "also set learning.drift = false and learning.online = false, as --method paper does"
        )
    return experiment


def merged_experiment(experiment: Experiment, table: Mapping[str, Any], locate: Locate) -> Experiment:
    """As `changed_experiment`, but without the check whether settings of different tables fit together."""
    rest = dict(table)
    if "method" in rest:
        learning, control = _chosen(METHODS, rest.pop("method"), locate("method"))
        experiment = replace(experiment, learning=learning, control=control)
    gap = rest.get("gap")
    if isinstance(gap, Mapping) and "preset" in gap:
        preset = _chosen(PRESETS, gap["preset"], locate("gap.preset"))
        experiment = replace(experiment, gap=preset())
        rest["gap"] = {key: value for key, value in gap.items() if key != "preset"}
    return merge(experiment, rest, locate, more=("method", "gap.preset"))


def _chosen(choices: Mapping[str, _Choice], name: Any, where: str) -> _Choice:
    """The choice of this name; `where` names the setting in the message of the InputError if there is none."""
    if name in list(choices):
        return choices[name]
    close = get_close_matches(str(name), choices, n=1)
    hint = f"; did you mean '{close[0]}'?" if close else ""
    wanted = " or ".join(f"'{known}'" for known in choices)
    raise InputError(f"{where} = {format_value(name)}, but it must be {wanted}{hint}")
