"""The start of a run, before the first step: its folder, and a reference that the nominal map can track."""

import fcntl
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import fields, replace
from datetime import datetime
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.output_files import free_name
from stepgap.base.ranges import format_value
from stepgap.control.reference import Reference
from stepgap.experiment.inputs import PRIOR_FOLDER, check_prior_is_used, load_known, load_priors
from stepgap.experiment.loop import Setup, is_finished
from stepgap.experiment.outcome import unheld_steps
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.records.recovery import INPUT_FILES
from stepgap.records.times_file import TIMES_FILE
from stepgap.robots.gap import Gap
from stepgap.robots.robot import Robot
from stepgap.step import StepMap


def dated_folder(home: str = "runs") -> Path:
    """Default folder of a run, named after date and time."""
    return Path(home) / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


@contextmanager
def run_folder(out: Path | None) -> Iterator[Path]:
    """The folder of a run: `out`, or else a new one, which no other process takes; it is removed if it stays empty."""
    if out is not None:
        yield out
        return
    folder = _made(dated_folder())
    try:
        yield folder
    finally:
        for unused in (folder, folder.parent):
            with suppress(OSError):  # it is not empty
                unused.rmdir()


def _made(folder_wanted: Path) -> Path:
    """Makes a folder of this name, or of the first free one after it; raises InputError if that is not possible."""
    try:
        folder_wanted.parent.mkdir(parents=True, exist_ok=True)
        while True:
            folder = free_name(folder_wanted)
            with suppress(FileExistsError):  # another process was faster
                folder.mkdir()
                return folder
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be written: {error.strerror}; choose a folder by --out") from None


def load_setup(request: PlantRequest, nominal: StepMap) -> Setup:
    """What an experiment with these settings runs.

    Args:
        request: Settings and reference, and what else its plants are made from.

    Raises:
        InputError: The map cannot hold a target, a table of commands is wanted but some targets are missing, the known
            steps are not valid, or no plant can be made.
    """
    settings = request.settings
    path = Path(settings.reference)
    name = path.name if path.parent == request.folder else settings.reference
    check_reach(nominal, request.reference, name, settings.robot)
    if settings.control.table and np.isnan(request.reference.targets).any():
        raise InputError("control.table: a table needs a target of every state coordinate at every step; set it to 0")
    steps = load_known(settings, settings.space)
    plants = choose_plants(request)
    check_prior_is_used(settings)
    priors = load_priors(settings, settings.space)
    return Setup(
        nominal,
        plants,
        request.reference,
        settings.learning,
        settings.control,
        settings.seed,
        steps,
        [file.prior for file in priors],
    )


def start_folder(folder: Path, write: Callable[[], None]) -> None:
    """Creates the run's folder, into which `write` writes its experiment; refuses one that already holds a run."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            if any((folder / name).exists() for name in ("experiment.toml", "steps.csv", "summary.json", "models")):
                raise InputError(f"{folder}: already holds a run; continue it by --resume, or choose another --out")
            if others := sorted(path.name for path in folder.iterdir() if not path.name.startswith(".")):
                raise InputError(f"{folder}: neither empty nor a run, it holds {others[0]}; choose another --out")
            write()
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; choose another --out"
        ) from None
    latest = folder.parent / "latest"
    if folder.parent.name == "runs" and (latest.is_symlink() or not latest.exists()):
        with suppress(OSError):  # the link is only a convenience
            latest.unlink(missing_ok=True)
            latest.symlink_to(folder.name)


def discard_unrecorded(folder: Path) -> None:
    """Removes what a run wrote that failed before its first step, so that the next try may use its folder."""
    recorded = (folder / name for name in ("steps.csv", "summary.json", "ticks"))
    if any(path.is_dir() or (path.exists() and path.stat().st_size) for path in recorded):
        return
    written = ("experiment.toml", "steps.csv", TIMES_FILE, "models/*.json", *INPUT_FILES)
    for path in (path for name in written for path in folder.glob(name)):
        if path.parent.resolve().is_relative_to(folder.resolve()):  # not through a link, to files of somebody else
            path.unlink()
    for name in ("models", PRIOR_FOLDER):
        with suppress(OSError):  # there is none, or it has other files
            (folder / name).rmdir()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Prevents other processes from starting a run in the folder at the same time."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def folder_to_continue(
    option: str, experiment: Path | None, out: Path | None, changes: Sequence[tuple[str, str]]
) -> Path:
    """Folder of an earlier run that `option`, --resume or --extend, continues, after a check of the other arguments."""
    if out is None:
        raise InputError(f"{option}: give the run by --out RUN")
    if experiment or changes:
        raise InputError(f"{option}: the run continues with its own settings; give no others")
    if not (out / "experiment.toml").is_file():
        raise InputError(
            f"{out}: contains no experiment.toml, so there is no run to continue; omit {option} to start one"
        )
    return out


def extended(run: Run, redeployments: int) -> Experiment:
    """Settings with which a finished run continues for a number of redeployments, whether the error still falls or not.

    Args:
        redeployments: At least 1.

    Raises:
        InputError: The run is not finished, or its record is not complete or cannot be read.
    """
    if redeployments < 1:
        raise InputError(f"--extend: {redeployments} redeployments; give an integer from 1 on")
    settings = run.needed(run.settings)
    remedy = f"finish it by: stepgap run --out {run.folder} --resume"
    done = len(run.deployments)
    if len(run.steps.iterations) > done:
        raise InputError(f"{run.folder}: the run was interrupted in deployment {done}; {remedy}")
    if not is_finished(run.deployments, run.space.error_scale, settings.learning):
        raise InputError(f"{run.folder}: the run was interrupted before deployment {done}; {remedy}")
    learning = replace(settings.learning, iterations=done - 1 + redeployments, early_stop=False)
    return replace(settings, learning=learning)


def check_reach(nominal: StepMap, reference: Reference, name: str, robot: Robot) -> None:
    """Raises InputError if the nominal map of `robot` cannot hold one of the targets."""
    unheld = unheld_steps(nominal, reference)
    if len(unheld):
        step = int(unheld.min())
        state = nominal.space.state
        values = zip(state, reference.targets[step], strict=True)
        target = ", ".join(f"{quantity.name} {value:g} {quantity.unit}" for quantity, value in values if value == value)
        raise InputError(
            f"reference {name}, step {step + 1}: {target} is out of reach: the model cannot hold it within the "
            f"command bounds{_changes(robot)}; `stepgap gait` shows its range, `stepgap check` proposes targets in it"
        )


def _changes(robot: Robot) -> str:
    """The first settings of the model that are not its defaults, one of which may be wrong, for a message."""
    default = type(robot)()
    changed = []
    for table in fields(robot):  # pyright: ignore[reportArgumentType]  (a robot is a dataclass)
        mine = getattr(robot, table.name)
        usual = getattr(default, table.name)
        for name, value in () if isinstance(mine, Gap) else vars(mine).items():
            if isinstance(value, int | float) and value != getattr(usual, name):
                changed.append(f"{table.name}.{name} = {format_value(value)}")
    return f" with {' and '.join(changed[:3])}" if changed else ""
