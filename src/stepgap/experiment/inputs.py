"""The files of an experiment: those that its settings name, and those of a folder with which it can be repeated."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import read_bounded_text, write_whole
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference, read_reference, reference_text
from stepgap.experiment.command_response import FEWEST_STEPS_PER_WEIGHT
from stepgap.experiment.settings import (
    LARGEST_NOMINAL_FILE,
    NO_PRIOR,
    PRIOR_OF_ROBOT,
    Experiment,
    is_constant_target,
    weighted_space,
    with_files,
)
from stepgap.experiment.settings_text import experiment_toml
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps, joined
from stepgap.records.prior_file import PriorFile, read_prior
from stepgap.records.steps_csv import RecordError, read_step_log, text_of
from stepgap.records.text import values_by_name
from stepgap.step import StepSpace

CONSTANT_STEPS = 50  # Number of steps with a target that names none
MOST_CONSTANT_STEPS = 5000  # Largest number of steps with one target

TRIAL_STEPS = 20  # Number of steps of a trial that are drawn
LONGEST_HELD = 3  # Largest number of steps for which a trial holds a target

SURROGATE = "nominal_map.json"  # File in a run's folder with the surrogate of a simulator

WARM_START = "warm_start.csv"
"""File in a run's folder with the steps that were known before its first deployment."""

PRIOR_FILE = "prior.json"
PRIOR_FOLDER = "priors"
"""File in a run's folder with the prior that its learning begins with, and folder with several of them."""


def load_reference(experiment: Experiment, space: StepSpace) -> Reference:
    """Reads the reference to track.

    Raises:
        InputError: The file does not exist or is not a reference, or a target is wrong.
    """
    built_in = experiment.robot.references()
    if experiment.reference in built_in:
        return _tracked(built_in[experiment.reference](), experiment).of(space)
    if is_constant_target(experiment.reference):
        return _constant_reference(experiment.reference, space)
    names = " or ".join(f"'{name}'" for name in built_in)
    path = Path(experiment.reference)
    remedy = f"reference must be {names}, a CSV file of targets, or one target such as {space.state_names[0]}=VALUE"
    try:
        every = weighted_space(
            experiment.robot.space, {name: weight or 1.0 for name, weight in experiment.weights.items()}
        )
        return _tracked(read_reference(path, every), experiment).of(space)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; {remedy}") from None
    except ValueError as error:
        raise InputError(str(error)) from None


def _constant_reference(text: str, space: StepSpace) -> Reference:
    """The reference of a target such as `speed=0.3,height=0.6,steps=50`; what it does not name is free."""
    target, _, number = text.partition(",steps=")
    if number and not (number.isdecimal() and 1 <= int(number) <= MOST_CONSTANT_STEPS):
        raise InputError(f"target {text}: steps must be an integer between 1 and {MOST_CONSTANT_STEPS}, at the end")
    values = values_by_name("target", target, space.state, np.full(len(space.state), np.nan))
    try:
        return Reference(space.state_names, np.tile(values, (int(number or CONSTANT_STEPS), 1))).of(space)
    except ValueError as error:
        raise InputError(f"target {text}: {error}") from None


def _tracked(reference: Reference, experiment: Experiment) -> Reference:
    """A reference without targets of the coordinates that the experiment does not track."""
    ignored = [experiment.weights.get(name) == 0 for name in reference.names]
    if not any(ignored):
        return reference
    targets = np.where(ignored, np.nan, reference.targets)
    if np.isnan(targets).all():
        remedy = "give targets of what is tracked, as a CSV file"
        raise InputError(f"reference '{experiment.reference}': it only has targets of a weight of 0; {remedy}")
    return replace(reference, targets=targets)


def run_folders(path: Path) -> list[Path]:
    """The folders of the runs in a folder, or of those of a sweep; the folder itself if it is a run or has none."""
    if (path / "steps.csv").exists():
        return [path]
    folders = [file.parent for file in (*path.glob("[!.]*/steps.csv"), *path.glob("runs/[!.]*/steps.csv"))]
    runs = {
        folder.resolve(): folder for folder in sorted(folders, reverse=True)
    }  # a link such as `latest` is no other run
    return sorted(runs.values()) or [path]


def load_known(experiment: Experiment, space: StepSpace) -> Steps:
    """Reads the steps known before the first deployment: those of a run and those it started from, or of many runs.

    Raises:
        InputError: It is not a run or a folder of runs, one has another state or command, or no step.
    """
    if not experiment.warm_start:
        return Steps(space)
    path = Path(experiment.warm_start)
    remedy = "a warm start needs the folder of a run, its steps.csv, or many runs"
    files = [path]
    if path.is_dir():
        runs = run_folders(path)
        earlier = [path / WARM_START] if runs == [path] and (path / WARM_START).is_file() else []
        files = [*earlier, *(folder / "steps.csv" for folder in runs)]
    try:
        steps = joined([read_step_log(file, space) for file in files])
    except OSError as error:
        raise InputError(f"{error.filename}: {error.strerror}; {remedy}") from None
    except RecordError as error:
        raise InputError(f"{error}; {remedy}, of the same state and command") from None
    if not len(steps):
        raise InputError(f"{files[-1]}: no step yet; {remedy} with at least one step")
    return steps


def load_priors(experiment: Experiment, space: StepSpace) -> list[PriorFile]:
    """Reads the priors over robots that learning begins with, of which a folder holds several.

    Raises:
        InputError: A file does not exist, is not a prior, or is that of another state, command or nominal map.
    """
    nominal = experiment.nominal.kind
    linear = experiment.nominal.linear
    built_in = experiment.prior == PRIOR_OF_ROBOT
    path = Path(experiment.prior)
    if built_in:
        shipped = experiment.robot.prior()
        believes = experiment.learning.drift and experiment.learning.residual == LearningSettings().residual
        if shipped is None or not believes or linear:
            return []
        path = shipped
    elif experiment.prior == NO_PRIOR:
        return []
    files = prior_files(path)
    priors = [_read_prior(file, experiment, space) for file in files]
    if built_in and any(prior.nominal != nominal for prior in priors):
        return []
    for one, file in zip(priors, files, strict=True):
        if one.nominal != nominal or linear:
            kind = f"a linear map of nominal.kind = '{nominal}'" if linear else f"nominal.kind = '{nominal}'"
            raise InputError(f"{file}: it is for nominal.kind = '{one.nominal}', but this experiment has {kind}")
    return priors


def check_prior_is_used(experiment: Experiment) -> None:
    """Raises InputError if a prior is wanted, but what is learned cannot begin with it."""
    learning = experiment.learning
    usual = LearningSettings().residual
    chosen = experiment.prior not in (PRIOR_OF_ROBOT, NO_PRIOR)
    if chosen and not (learning.drift and learning.residual == usual):
        raise InputError(
            f"prior = {experiment.prior!r}: only beliefs begin with a prior; leave it out, or set learning.residual = "
            f"{usual!r} and learning.drift = true"
        )


def prior_files(path: Path) -> list[Path]:
    """The file itself, or the files of priors in a folder, by name."""
    if not path.is_dir():
        return [path]
    if not (files := sorted(path.glob("[!.]*.json"))):
        raise InputError(f"{path}: no file of `stepgap prior` (.json) is in this folder")
    return files


def _read_prior(path: Path, experiment: Experiment, space: StepSpace) -> PriorFile:
    try:
        prior = read_prior(path, space)
    except OSError as error:
        raise InputError(
            f"{path}: {error.strerror}; prior must be robot, none or a file of `stepgap prior`, or a folder of them"
        ) from None
    except ValueError as error:
        raise InputError(str(error)) from None
    if prior.robot != experiment.robot.name:
        raise InputError(f"{path}: it is of robot '{prior.robot}', but this one is '{experiment.robot.name}'")
    return prior


def experiment_files(
    experiment: Experiment, reference: Reference, known: Steps | None = None, surrogate: str = ""
) -> dict[str, str]:
    """Texts by file name of a folder with which an experiment can be repeated: all settings are in `experiment.toml`.

    A reference, a nominal map, earlier steps and what a robot wants copied are among the files, so that the folder is
    complete. The file of a rig is not: it belongs to the machine on which it was checked. Nor is a policy; both are
    named by absolute paths.

    Args:
        known: Steps that are known before the first deployment.
        surrogate: Text of the file of its nominal map, if that was fitted for it.

    Raises:
        InputError: A file cannot be read.
    """
    files = dict[str, str]()
    if experiment.rig:
        experiment = replace(experiment, rig=str(Path(experiment.rig).resolve()))
    if experiment.reference not in experiment.robot.references():
        files["reference.csv"] = reference_text(reference)
        experiment = replace(experiment, reference="reference.csv")
    if experiment.nominal.file or surrogate:
        path = Path(experiment.nominal.file or SURROGATE)
        name = f"nominal_map{path.suffix}"
        files[name] = surrogate or _text_of(path, "nominal.file")
        experiment = replace(experiment, nominal=replace(experiment.nominal, file=name))

    def copied(name: str, value: str) -> str:
        if not experiment.robot.files[name]:
            return str(Path(value).resolve())
        file = f"{name.replace('.', '_')}{Path(value).suffix}"
        files[file] = _text_of(Path(value), name)
        return file

    experiment = replace(experiment, robot=with_files(experiment.robot, copied))
    if experiment.prior not in (PRIOR_OF_ROBOT, NO_PRIOR):
        path = Path(experiment.prior)
        several = path.is_dir()
        files |= {
            f"{PRIOR_FOLDER}/{file.name}" if several else PRIOR_FILE: _text_of(file, "prior")
            for file in prior_files(path)
        }
        experiment = replace(experiment, prior=PRIOR_FOLDER if several else PRIOR_FILE)
    if known:
        files[WARM_START] = text_of(known)
        experiment = replace(experiment, warm_start=WARM_START)
    return {**files, "experiment.toml": experiment_toml(experiment)}


def write_experiment(
    folder: Path, experiment: Experiment, reference: Reference, known: Steps | None = None, surrogate: str = ""
) -> None:
    """Writes the files of `experiment_files`."""
    for name, text in experiment_files(experiment, reference, known, surrogate).items():
        write_whole(folder / name, text)


def _text_of(path: Path, name: str) -> str:
    try:
        return read_bounded_text(path, LARGEST_NOMINAL_FILE)
    except (OSError, ValueError) as error:
        raise InputError(f"{name}: {message_of(error)}") from None


def trial_reference(settings: Experiment, held: Reference) -> Reference:
    """The targets of a reference in random order, each for one to `LONGEST_HELD` steps.

    There are at least `TRIAL_STEPS` of them, and as many as `command_response` needs.
    """
    targets = held.targets[held.distinct[0]]
    rng = random_stream(settings.seed, 0, 3)
    weights = 1 + len(settings.robot.space.state) + 2 * len(settings.robot.space.command)
    steps = max(TRIAL_STEPS, 1 + FEWEST_STEPS_PER_WEIGHT * weights)
    numbers = np.repeat(rng.integers(len(targets), size=steps), rng.integers(1, LONGEST_HELD + 1, size=steps))
    return Reference(held.names, targets[numbers[:steps]])
