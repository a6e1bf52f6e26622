"""A run folder, read strictly: the steps executed, how well they tracked, and with which settings.

The folder may still be growing: `steps.csv` may hold steps of a deployment that `summary.json` does not know yet.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.base.settings_file import read_toml_text
from stepgap.control.reference import paper_reference
from stepgap.learning.step_log import StepLog
from stepgap.records.paper import STATE_NAMES
from stepgap.records.steps_csv import digest, ends_with_whole_row, read_step_log, space_of_header
from stepgap.records.summary import LARGEST_NUMBER, Deployment, Summary, read_summary
from stepgap.step import Array, StepSpace


@dataclass(frozen=True)
class SettingsFile:
    """An `experiment.toml`, whether or not its settings are known here.

    Attributes:
        text: Its text.
        table: Its content as TOML.
    """

    text: str
    table: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The content of a run folder.

    Attributes:
        folder: Where it was read.
        space: Names and units of state and command; a unit may be empty, the bounds mean nothing.
        steps: Every step recorded; at least one.
        summary: Errors of the deployments that are finished.
        settings: `experiment.toml`; None if there is none.
        cut_off: Whether the last row of `steps.csv` was cut off in the middle of writing; it is not in `steps`.
    """

    folder: Path
    space: StepSpace
    steps: StepLog
    summary: Summary
    settings: SettingsFile | None
    cut_off: bool = False

    @property
    def deployments(self) -> tuple[Deployment, ...]:
        """The finished ones, rising."""
        return self.summary.deployments

    @property
    def noise_floor(self) -> Array:
        """Standard deviation of the next state at equal state and command, NaN where unknown; shape (n,)."""
        spread = self.summary.repeatability
        return np.full(len(self.space.state), np.nan) if spread is None else spread

    @property
    def shown_iterations(self) -> list[int]:
        """Iterations that figures show: the finished ones, or while there are none, those with steps."""
        return [deployment.iteration for deployment in self.deployments] or self.steps.iterations

    @property
    def like_paper(self) -> bool:
        """Whether it tracked the paper's state along the paper's reference, so that the paper's errors compare."""
        if self.space.state_names != STATE_NAMES:
            return False
        wanted, fell = paper_reference().targets, {each.iteration for each in self.deployments if each.falls}
        for number in self.steps.iterations:
            targets = self.steps.of_iteration(number).tracking().target
            broken_off = number in fell or number in self.unfinished
            if not np.array_equal(targets, wanted[: len(targets)]) or not (broken_off or len(targets) == len(wanted)):
                return False
        return True

    @property
    def unfinished(self) -> dict[int, int]:
        """Number of steps recorded of each deployment that is not in `summary.json`."""
        finished = {deployment.iteration for deployment in self.deployments}
        return {
            number: len(self.steps.of_iteration(number)) for number in self.steps.iterations if number not in finished
        }


def read_run_folder(folder: Path, space: StepSpace | None = None) -> RunRecord:
    """Reads `steps.csv`, and where they are there, `summary.json` and `experiment.toml`.

    Args:
        folder: The run folder.
        space: Names and units of state and command; by default those of the header of `steps.csv`.

    Raises:
        ValueError: A file is not what it must be; the message names it and says what would be right.
        OSError: The folder or a file cannot be read.
    """
    path = folder / "steps.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; {folder} must be the folder of a run, which holds it")
    space = space or space_of_header(path)
    summary = read_summary(folder / "summary.json", space.state_names)  # before the steps, which only grow meanwhile
    steps = _read_steps(path, space)
    _check_same_run(summary, steps, folder / "summary.json")
    settings = _read_settings(folder / "experiment.toml")
    return RunRecord(folder, space, steps, summary, settings, not ends_with_whole_row(path))


def _read_steps(path: Path, space: StepSpace) -> StepLog:
    """The steps, checked to be of a size that can be drawn."""
    steps = read_step_log(path, space)
    if not len(steps):
        raise ValueError(f"{path}: no step yet; it must have a header and at least one row below it")
    columns = np.hstack([steps.state, steps.target, steps.next_state, steps.predicted, steps.std])
    if (np.abs(columns[np.isfinite(columns)]) > LARGEST_NUMBER).any() or (steps.std < 0).any():
        raise ValueError(
            f"{path}: a state is beyond ±{LARGEST_NUMBER:g} or an std_… negative; both must be in SI units"
        )
    return steps


def _check_same_run(summary: Summary, steps: StepLog, path: Path) -> None:
    """Raises ValueError unless the summary is of these steps, or of the first of them."""
    for deployment in summary.deployments:
        rows = steps.of_iteration(deployment.iteration)
        if (len(rows), rows.falls) != (deployment.steps, deployment.falls):
            raise ValueError(
                f"{path}: deployment {deployment.iteration} has {deployment.steps} steps and {deployment.falls} falls, "
                f"in steps.csv {len(rows)} and {rows.falls}; both must be of one run"
            )
    count = sum(deployment.steps for deployment in summary.deployments)
    if summary.steps_sha256 and summary.steps_sha256 != digest(StepLog(steps.space, islice(steps, count))):
        raise ValueError(f"{path}: steps.csv was changed after it was written; both must be of one run")


def _read_settings(path: Path) -> SettingsFile | None:
    if not path.exists():
        return None
    if not path.is_file():
        raise ValueError(f"{path}: not a file; it must be a text file that the run wrote")
    return SettingsFile(*read_toml_text(path, "the file that the run wrote"))
