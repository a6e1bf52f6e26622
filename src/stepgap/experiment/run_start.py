"""What `stepgap run` makes sure of before the first hop: a folder of its own, and settings that can work."""

import fcntl
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.reference import Reference
from stepgap.experiment.settings import Experiment, write_experiment
from stepgap.learning.step_log import StepLog
from stepgap.step import StepFailed, StepMap

ALSO_WRITTEN = ("reference.csv", "warm_start.csv", "report.html", "figures", "replay", "ticks")
"""What else a run may write into its folder."""


def dated_folder() -> Path:
    """Where a run goes that was given no folder."""
    return Path("runs") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def start_folder(folder: Path, settings: Experiment, reference: Reference, known: StepLog) -> None:
    """Makes the run's folder with its resolved settings; never takes one that holds a run."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            if any((folder / name).exists() for name in ("experiment.toml", "steps.csv", "summary.json", "models")):
                raise InputError(f"{folder}: holds a run already; go on with it by --resume, or choose another --out")
            if there := [name for name in ALSO_WRITTEN if (folder / name).exists()]:
                raise InputError(
                    f"{folder}: {there[0]} is there already and would be written over; choose another --out"
                )
            write_experiment(folder, settings, reference, known)
    except OSError as error:
        raise InputError(
            f"{error.filename or folder}: cannot be written: {error.strerror}; choose another --out"
        ) from None
    latest = folder.parent / "latest"
    if folder.parent.name == "runs" and (latest.is_symlink() or not latest.exists()):
        with suppress(OSError):  # only for convenience
            latest.unlink(missing_ok=True)
            latest.symlink_to(folder.name)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Keeps other processes from starting a run in the folder at the same moment."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        with suppress(OSError):  # a file system without locks
            fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)


def folder_to_resume(experiment: Path | None, out: Path | None, changes: Sequence[tuple[str, str]]) -> Path:
    """The folder of a run that was broken off."""
    if out is None:
        raise InputError("--resume: say which run by --out RUN")
    if experiment or changes:
        raise InputError("--resume: the run goes on with the settings it has; give no others")
    if not (out / "experiment.toml").is_file():
        raise InputError(f"{out}: no experiment.toml there, so there is no run to resume; start one without --resume")
    return out


def check_reach(nominal: StepMap, reference: Reference, name: str) -> None:
    """Raises InputError where the nominal map cannot hold a target."""
    for step in [0, *reference.changes]:
        target = reference.targets[step]
        try:
            held = fixed_point(nominal, target).held
        except StepFailed:
            held = False
        if not held:
            state = nominal.space.state
            wanted = ", ".join(f"{q.name} {value:g} {q.unit}" for q, value in zip(state, target, strict=True))
            raise InputError(
                f"reference {name}, step {step + 1}: {wanted} is out of reach: the model cannot hold it within the "
                f"command bounds; `stepgap gait` shows what it can"
            )
