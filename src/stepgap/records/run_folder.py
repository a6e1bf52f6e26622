"""A run folder, read with strict checks: the executed steps, their tracking errors, and the settings.

The run may still be in progress: `steps.csv` may hold steps of a deployment that is not yet in `summary.json`.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isclose, isfinite
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.base.json_data import LARGEST_NUMBER
from stepgap.base.normal import std_interval_95
from stepgap.base.settings_file import read_toml_text
from stepgap.learning.steps import Steps
from stepgap.records.model_files import model_path
from stepgap.records.steps_csv import digest, ends_with_whole_row, read_step_log, space_of_header
from stepgap.records.summary import Deployment, NoiseFloor, Summary, read_summary
from stepgap.robots.published_result import PublishedResult
from stepgap.step import Array, StepSpace

INPUT_FILES = ("reference.csv", "warm_start.csv", "nominal_map.json", "nominal_map.toml", "nominal_map.csv")
"""Files of a run folder, besides `experiment.toml`, that are written before the first step."""


@dataclass(frozen=True)
class SettingsFile:
    """Content of an `experiment.toml`, which may have settings that this version does not know.

    Attributes:
        text: Text of the file.
        table: Content of the file as a TOML table.
    """

    text: str
    table: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class RunRecord:
    """The content of a run folder.

    Attributes:
        folder: The run folder.
        space: Names and units of state and command; a unit may be empty, and the bounds have no meaning.
        steps: All recorded steps, at least one.
        summary: Errors of the finished deployments.
        settings: Content of `experiment.toml`; None if there is none.
        cut_off: Whether the last row of `steps.csv` was not completely written; it is not in `steps`.
        published: Published result of the robot; None if there is none, or if the robot is not known.
    """

    folder: Path
    space: StepSpace
    steps: Steps
    summary: Summary
    settings: SettingsFile | None
    cut_off: bool = False
    published: PublishedResult | None = None

    @property
    def deployments(self) -> tuple[Deployment, ...]:
        """Finished deployments in ascending order."""
        return self.summary.deployments

    @property
    def noise_floor(self) -> Array:
        """Noise floor, the standard deviation of repeated steps, NaN where unknown; shape (n,)."""
        return self._floors.any_phase

    @property
    def noise_floor_same_phase(self) -> Array:
        """The same at one phase, so that only the noise differs, NaN where unknown; shape (n,)."""
        return self._floors.same_phase

    @property
    def noise_floor_interval(self) -> Array:
        """Ends of the 95 % confidence interval of the noise floor, NaN where unknown; shape (2, n)."""
        return std_interval_95(self._floors.any_phase, self._floors.any_phase_freedom)

    @property
    def noise_floor_same_phase_interval(self) -> Array:
        """Ends of the 95 % confidence interval of that at one phase, NaN where unknown; shape (2, n)."""
        return std_interval_95(self._floors.same_phase, self._floors.same_phase_freedom)

    @property
    def noise_floor_steps(self) -> int:
        """Number of steps from which the noise floor was computed; 0 if it is not known."""
        return self._floors.steps

    @property
    def _floors(self) -> NoiseFloor:
        return self.summary.noise_floor or NoiseFloor.unknown(len(self.space.state))

    @property
    def shown_iterations(self) -> list[int]:
        """Deployments that figures show: the finished ones or, while there are none, those with steps."""
        return [deployment.iteration for deployment in self.deployments] or self.steps.iterations

    def residual_of(self, iteration: int) -> str | None:
        """Name of the residual of a deployment, `none` for the nominal map; None where it is not known.

        Of an unfinished deployment 0 it is known as long as its predictions have no standard deviation: they are those
        of the nominal map.
        """
        names = {deployment.iteration: deployment.residual for deployment in self.deployments}
        nominal = iteration == 0 and not self.steps.of_iteration(0).std.any()
        return names.get(iteration, "none" if nominal else None)

    @property
    def has_unsaved_residual(self) -> bool:
        """Whether deployment 0 is the last one and learned from the nominal map on: no file has its residual."""
        last = self.shown_iterations[-1]
        return last == 0 and self.residual_of(0) != "none" and not model_path(self.folder, 0).exists()

    @property
    def compared_result(self) -> PublishedResult | None:
        """The published result if the run has its reference, so that its errors can be compared; else None."""
        incomplete = {each.iteration for each in self.deployments if each.failed_steps} | set(self.unfinished)
        tracked = self.published is not None and all(
            self.published.is_tracked_by(self.steps.of_iteration(number).tracking().target, number not in incomplete)
            for number in self.steps.iterations
        )
        return self.published if tracked else None

    @property
    def unfinished(self) -> dict[int, int]:
        """Number of recorded steps of each deployment that is not in `summary.json`."""
        finished = {deployment.iteration for deployment in self.deployments}
        return {
            number: len(self.steps.of_iteration(number)) for number in self.steps.iterations if number not in finished
        }


def read_run_folder(
    folder: Path, space: StepSpace | None = None, published: PublishedResult | None = None
) -> RunRecord:
    """Reads `steps.csv` and, where they exist, `summary.json` and `experiment.toml`.

    Args:
        folder: The run folder.
        space: Names and units of state and command; by default the names in the header of `steps.csv`, without units.
        published: Published result of the robot, if there is one.

    Raises:
        ValueError: The content of a file is wrong; the message names the file and the rule.
        OSError: The folder or a file cannot be read.
    """
    path = folder / "steps.csv"
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; {folder} must be the folder of a run, which holds it")
    space = space or space_of_header(path)
    summary = read_summary(folder / "summary.json", space.state_names)  # read first, because steps may be added
    steps = _read_steps(path, space)
    _check_same_run(summary, steps, folder / "summary.json")
    settings = read_settings_file(folder / "experiment.toml")
    return RunRecord(folder, space, steps, summary, settings, not ends_with_whole_row(path), published)


def _read_steps(path: Path, space: StepSpace) -> Steps:
    """Reads the steps and checks that their values can be plotted."""
    steps = read_step_log(path, space)
    if not len(steps):
        raise ValueError(f"{path}: no step yet; it must have a header and at least one row below it")
    columns = np.hstack([steps.state, steps.target, steps.next_state, steps.predicted, steps.std])
    if (np.abs(columns[np.isfinite(columns)]) > LARGEST_NUMBER).any() or (steps.std < 0).any():
        raise ValueError(
            f"{path}: a state is larger than ±{LARGEST_NUMBER:g} or an std_… negative; both must be in SI units"
        )
    return steps


def _check_same_run(summary: Summary, steps: Steps, path: Path) -> None:
    """Raises ValueError unless the summary describes these steps, or the first of them."""
    for deployment in summary.deployments:
        rows = steps.of_iteration(deployment.iteration)
        recorded, failed = len(rows), rows.failed_steps
        if (recorded, failed) != (deployment.steps, deployment.failed_steps):
            raise ValueError(
                f"{path}: deployment {deployment.iteration} has {deployment.steps} steps, {deployment.failed_steps} of "
                f"them failed, in steps.csv {recorded} and {failed}; both must be of the same run"
            )
    count = sum(deployment.steps for deployment in summary.deployments)
    if summary.steps_sha256 and summary.steps_sha256 != digest(steps.selected(slice(count))):
        raise ValueError(f"{path}: steps.csv was changed after it was written; both must be of the same run")
    for deployment in summary.deployments:
        _check_rmse(deployment, steps, path)


def _check_rmse(deployment: Deployment, steps: Steps, path: Path) -> None:
    """Raises ValueError unless the RMSE of a deployment is that of its steps; one that is not known is not checked."""
    errors = steps.of_iteration(deployment.iteration).tracking_errors()
    if not len(errors):
        return
    found = np.sqrt(np.mean(errors**2, axis=0))
    for name, error, computed in zip(steps.space.state_names, deployment.rmse, found, strict=True):
        if isfinite(error) and not isclose(error, computed, rel_tol=1e-6):
            raise ValueError(
                f"{path}: rmse of {name} of deployment {deployment.iteration} is {error:.6g}, but that of its steps in "
                f"steps.csv is {computed:.6g}; both must be of the same run"
            )


def read_settings_file(path: Path) -> SettingsFile | None:
    """Reads an `experiment.toml`; None if it does not exist.

    Raises:
        ValueError: It is not a TOML file.
    """
    if not path.exists():
        return None
    if not path.is_file():
        raise ValueError(f"{path}: not a file; it must be a text file that the run wrote")
    return SettingsFile(*read_toml_text(path, "the file that the run wrote"))
