"""The experiment from Python: `stepgap.run` does what the command of the same name does."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.errors import InputError
from stepgap.base.start_method import program_left_alone
from stepgap.cli.nominal import nominal_with_progress
from stepgap.cli.progress import RunProgress
from stepgap.control.reference import Reference
from stepgap.experiment.inputs import load_reference, write_experiment
from stepgap.experiment.loop import run_experiment
from stepgap.experiment.plants import PlantRequest, plant_compiled_beside
from stepgap.experiment.recorders import TimeRecorder
from stepgap.experiment.run import Run
from stepgap.experiment.run_start import folder_to_continue, load_setup, run_folder, start_folder
from stepgap.experiment.settings import Experiment, read_experiment, with_settings
from stepgap.plants.plant import Plant
from stepgap.records.steps_csv import check_names
from stepgap.robots.robot import Robot

OWN_PLANT = "own"  # Name in settings of a plant that was given as an object


def run(
    robot: str | PathLike[str] | Robot | None = None,
    *,
    out: str | PathLike[str] | None = None,
    targets: ArrayLike | None = None,
    plant: str | Callable[[np.random.Generator], Plant] | None = None,
    program: Sequence[str] = (),
    resume: bool = False,
    progress: bool = True,
    **settings: Any,
) -> Run:
    """Runs the whole sim-to-real experiment: deploy, learn, redeploy. On a simulation, unless a plant is given.

    It is the experiment of the command `stepgap run`: the same settings, in the same folder, give the same bytes.

        import stepgap

        stepgap.run(iterations=2, seed=1)
        stepgap.run("quadruped", gap="random:7", online=True)
        stepgap.run("experiment.toml", out="runs/first")

    Args:
        robot: Name of a robot, an `experiment.toml`, or a `Robot`; None for the hopper of the paper. A name that ends
            in `.toml` is a file.
        out: New folder for the results; None for a new one in `runs/`.
        targets: State wanted at the end of each step, NaN where nothing is wanted; shape (steps, n), SI units. None
            for the reference of the settings.
        plant: Name of a plant, or what makes one of your own from a random generator, such as its class.
        program: Command line of the robot's program, for the plant `process`.
        resume: Whether an interrupted run in `out` goes on, with its own settings.
        progress: Whether to show how far it is.
        settings: As in the file: keys, and tables as mappings, such as `gap={"payload": 0.1}`; also `iterations`,
            `gap="random:7"`, `online`, `explore` and `warm_start`, as the command has them.

    Returns:
        The run. Its `steps` are the recorded ones, `deployments` their errors; `stepgap report FOLDER` shows it.

    Raises:
        InputError: A setting or a target is wrong, or the folder already holds a run.
        KeyboardInterrupt: It was interrupted; `resume=True` goes on.
    """
    own = None if plant is None or isinstance(plant, str) else plant
    changes = [*setting_entries(settings if own or plant is None else {**settings, "plant": plant})]
    folder_of_run = None if out is None else Path(fspath(out))
    if resume:
        given = changes or robot is not None or targets is not None
        file = folder_to_continue("resume", Path("settings") if given else None, folder_of_run, changes)
        experiment = read_experiment(file / "experiment.toml", recorded=True)
    else:
        experiment = _experiment(robot, changes)
    check_names(experiment.space)
    if targets is None:
        reference = load_reference(experiment, experiment.space)
    else:
        reference = _reference(experiment, targets)
        experiment = replace(experiment, reference="targets")
    if own:
        experiment = replace(experiment, plant=OWN_PLANT)
    with run_folder(folder_of_run) as folder, program_left_alone():
        with plant_compiled_beside(experiment):
            nominal = nominal_with_progress(experiment, reference)
        setup = load_setup(PlantRequest(experiment, reference, folder, program=program, own=own), nominal.map)
        if not resume:
            start_folder(folder, partial(write_experiment, folder, experiment, reference, setup.known, nominal.file))
        iterations = setup.learning.iterations
        with RunProgress(experiment.space, len(reference), iterations, quiet=not progress) as display:
            run_experiment(setup, folder, TimeRecorder(folder).observing(display.observer))
        return Run(folder, settings=experiment, nominal=nominal.map)


def _experiment(robot: str | PathLike[str] | Robot | None, changes: list[tuple[str, str]]) -> Experiment:
    """The settings of an experiment with a robot, by name, file or object."""
    if isinstance(robot, Robot):
        return with_settings(Experiment(robot), changes)
    if robot is None:
        return read_experiment(None, changes)
    name = fspath(robot)
    if name.endswith(".toml"):
        return read_experiment(Path(name), changes)
    return read_experiment(None, [("robot", json.dumps(name)), *changes])


def _reference(experiment: Experiment, targets: ArrayLike) -> Reference:
    """The reference of an array of targets."""
    names = experiment.space.state_names
    values = np.asarray(targets, float)
    if values.ndim != 2 or values.shape[1] != len(names):
        shape = f"(steps, {len(names)}), a column for each of {', '.join(names)}"
        raise InputError(f"targets: they have the shape {values.shape}; it must be {shape}")
    try:
        return Reference(names, values).of(experiment.space)
    except ValueError as error:
        raise InputError(f"targets: {error}") from None


def setting_entries(settings: Mapping[str, Any], table: str = "") -> Iterator[tuple[str, str]]:
    """Dotted names and TOML values of nested settings."""
    for key, value in settings.items():
        if isinstance(value, Mapping):
            yield from setting_entries(value, f"{table}{key}.")
            continue
        plain = value.item() if isinstance(value, np.generic) else value
        plain = fspath(plain) if isinstance(plain, PathLike) else plain
        try:
            yield f"{table}{key}", json.dumps(plain, ensure_ascii=False)
        except TypeError:
            kind = type(value).__name__
            raise InputError(f"{table}{key}: {kind} is no setting; give a number, a text, true or false") from None
