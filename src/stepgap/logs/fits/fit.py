"""Input of `stepgap fit`: the error of the nominal map in any log, and what is held out."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.learning.observations import Observations
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.steps import Steps, joined
from stepgap.logs.columns import Columns
from stepgap.logs.fits.validation import (
    FOLDS,
    LEAST_STEPS,
    Folds,
    OnFit,
    Validation,
    contiguous_folds,
    deployment_folds,
    validate,
    validate_on,
)
from stepgap.logs.foreign_log import FoundSteps, describe_left_out, read_foreign_logs
from stepgap.records.model_files import MAP, NominalSource, saved_model_text
from stepgap.records.steps_csv import RecordError, read_step_log
from stepgap.step import Array, StepSpace, StepStatus

MOST_STEPS = 100_000  # Largest number of steps; those of a day of hopping

NOMINALS = {
    MAP: "the robot's nominal map",
    "predicted": "the predictions in the log",
    "target": "the target, which is the prediction of a controller's map",
    "state": "the state, as if a step did not change it",
}
"""Sources of the nominal next states, with descriptions."""

FAR: Final = 1.25
"""A number is suspicious if it is beyond the middle nine tenths of all by more than this multiple of their range,"""

FAR_FROM_CONSTANT: Final = 50.0  # which counts as this multiple of their value if they are all equal

MOST_SUSPICIOUS: Final = 0.1
"""If a larger part of the rows seemed to be suspicious, the others are no measure of them, and none is."""

Settings = Sequence[tuple[str, str]]
"""Dotted names and values."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Steps to which residuals are fitted.

    Attributes:
        steps: Steps that ended with a next state, with the nominal next states as predictions.
        observed: Errors of these predictions.
        origin: Where each step was recorded, for messages; shape (N,).
        left_out: Number of excluded rows by reason, such as "that ended without a next state"; no zeros.
        nominal: Description of the source of the predictions.
        source: That source: its name is a key of `NOMINALS`.
        columns: Meaning of the columns if the ranges of state and command are those of the data; None if they are those
            of a robot.
    """

    steps: Steps
    observed: Observations
    origin: NDArray[np.str_]
    left_out: Mapping[str, int]
    nominal: str
    source: NominalSource
    columns: Columns | None = None

    def without(self, rows: Iterable[int]) -> "FitData":
        """The data without some rows, with the ranges of the others."""
        kept = ~np.isin(np.arange(len(self.steps)), list(rows))
        rest = replace(
            self, steps=self.steps.selected(kept), observed=self.observed.selected(kept), origin=self.origin[kept]
        )
        return rest.in_space(self.columns.space(rest.steps.state, rest.steps.requested)) if self.columns else rest

    def in_space(self, space: StepSpace) -> "FitData":
        """The same data with other ranges."""
        return replace(self, steps=self.steps.in_space(space), observed=replace(self.observed, space=space))


def read_fit_data(
    logs: Sequence[Path], columns: Columns | None, nominal: str | None, experiment: Path | None, overrides: Settings
) -> FitData:
    """Reads the steps of logs and computes their nominal next states.

    Args:
        logs: Run folders or their `steps.csv`; with `columns`, any CSV files.
        columns: Meaning of the columns of such files.
        nominal: A key of `NOMINALS`; None to choose by the content of the logs.
        experiment: Settings of the robot; None for those of the runs or, without runs, the defaults.
        overrides: Single settings that override these.

    Raises:
        InputError: The arguments do not fit each other, or the steps are too few or too many.
        RecordError: The content of a log is wrong.
    """
    if nominal not in (None, MAP) and (experiment or overrides):
        raise InputError(f"--nominal {nominal}: it has no settings; leave them out")
    for name, _ in overrides:
        if name.startswith("learning."):
            raise InputError(f"--{name}: every residual is fitted, without settings of learning; leave it out")
    recorded = columns is None and experiment is None
    if columns is None:
        logs = [log / "steps.csv" if log.is_dir() else log for log in logs]
        experiment = experiment or _common_experiment(logs)
    settings = read_experiment(experiment, overrides, recorded=recorded)
    space = settings.space
    log_steps = _read_runs(logs, space) if columns is None else read_foreign_logs(logs, columns)
    steps = log_steps.steps
    source = nominal or _nominal_of(log_steps.steps, space)
    description = NOMINALS[source]
    step_map = None
    predicted = {"target": steps.target, "state": steps.state}.get(source, steps.predicted)
    if source == MAP:
        log_steps = log_steps._replace(steps=steps.in_space(_same_names(steps.space, space)))
        step_map = load_nominal(settings).map
        predicted = step_map.evaluate(steps.state, steps.requested).next_state
        description += f" with the settings of {experiment}" if experiment else " with default settings"
        description += ", some overridden" if overrides else ""
    elif len(steps) and np.isnan(predicted).any(axis=1).all():
        some = "none" if np.isnan(predicted).all() else "no step with one for every state coordinate"
        raise InputError(f"--nominal {source}: the log has {some}; name its columns by --{source}")
    data = _with_errors(log_steps, predicted, description, NominalSource(source, step_map))
    count = len(data.steps)
    if not LEAST_STEPS <= count <= MOST_STEPS:
        usable = f"{count} usable step{'' if count == 1 else 's'}, but there must be {LEAST_STEPS} to {MOST_STEPS}"
        left_out = describe_left_out(data.left_out)
        raise InputError(f"{', '.join(map(str, logs))}: {usable}; rows left out: {left_out}")
    return data if source == MAP else replace(data, columns=columns)


def _with_errors(log_steps: FoundSteps, predicted: Array, nominal: str, source: NominalSource) -> FitData:
    """The steps that have a nominal next state (N, n), and its errors; arguments as of `FitData`."""
    rows = np.flatnonzero(np.isfinite(predicted).all(axis=1))
    left_out = dict(log_steps.left_out)
    if failed := len(predicted) - len(rows):
        reason = "for which the nominal map predicts a failure" if source.step_map else f"without a whole {source.name}"
        left_out[reason] = failed
    steps = log_steps.steps.with_columns(predicted=predicted).selected(rows)
    observed = Observations(steps.space, steps.state, steps.requested, steps.next_state - steps.predicted)
    return FitData(steps, observed, log_steps.origin[rows], left_out, nominal, source)


def _common_experiment(logs: Sequence[Path]) -> Path | None:
    """Settings in the folders of the logs, if they describe the same nominal map."""
    files = [log.with_name("experiment.toml") if log.with_name("experiment.toml").is_file() else None for log in logs]
    read = [read_experiment(file, recorded=True) for file in files]
    maps = [(experiment.robot.as_modelled, experiment.nominal) for experiment in read]
    for log, own_map in zip(logs, maps, strict=True):
        if own_map != maps[0]:
            raise InputError(f"{log}: recorded with another robot or nominal map than {logs[0]}; give --experiment")
    return files[0]


def _read_runs(logs: Sequence[Path], space: StepSpace) -> FoundSteps:
    """Reads the steps of runs; their deployments are numbered as `joined` does.

    Their predictions are omitted: they may be those of a corrected map.
    """
    runs: list[Steps] = []
    for path in logs:
        try:
            runs.append(read_step_log(path, space))
        except OSError as error:
            raise InputError(
                f"{path}: {error.strerror}; give the folder of a run, its steps.csv, or a CSV file"
            ) from None
        except RecordError as error:
            raise InputError(f"{error}; for any other CSV file name its columns, see --help") from None
    steps = joined(runs)
    done = steps.status == StepStatus.OK
    left_out = {"that ended without a next state": steps.failed_steps}
    numbers = zip(steps.iteration.tolist(), steps.number.tolist(), strict=True)
    origin = np.array([f"deployment {iteration}, step {number}" for iteration, number in numbers], np.str_)
    return FoundSteps(
        steps.with_columns(predicted=np.nan).selected(done),
        steps.phase[done],
        origin[done],
        left_out if steps.failed_steps else {},
    )


def _nominal_of(steps: Steps, space: StepSpace) -> str:
    """Source of the nominal next states if none is given."""
    if np.isfinite(steps.predicted).any():
        return "predicted"
    if space.has_names_of(steps.space):
        return MAP
    raise InputError(
        "--nominal: the log contains no predicted next states; name their columns by --predicted, or choose --nominal "
        "target or --nominal state"
    )


def _same_names(column_space: StepSpace, space: StepSpace) -> StepSpace:
    """The robot's space, after a check that the columns have its names."""
    if space.has_names_of(column_space):
        return space
    names = ",".join(column_space.names)
    wanted = ",".join(space.names)
    raise InputError(f"--nominal map: state and command are {names}; it must be {wanted}; rename by NAME=COLUMN")


def choose_folds(steps: Steps, count: int | None) -> Folds:
    """Folds of whole deployments if there are several and no count is given, otherwise `count` contiguous blocks."""
    if count is None and len(steps.iterations) > 1:
        return deployment_folds(steps.iteration)
    if count is not None and not 2 <= count <= len(steps):
        raise InputError(f"--folds {count}: it must lie between 2 and the number of steps, {len(steps)}")
    return contiguous_folds(len(steps), count or FOLDS)


def read_test_data(
    data: FitData,
    logs: Sequence[Path],
    test: Sequence[Path],
    columns: Columns | None,
    nominal: str | None,
    experiment: Path | None,
    overrides: Settings,
) -> FitData:
    """Reads the steps on which the residuals that are fitted to `data` are scored.

    Args:
        data: Steps to fit.
        logs: The logs from which they were read.
        test: Logs of the same kind, read with the arguments of `read_fit_data`.

    Raises:
        InputError: A log is used for both, or is not of the same robot and nominal map; or as of `read_fit_data`.
        RecordError: As of `read_fit_data`.
    """
    if both := {log.resolve() for log in logs} & {log.resolve() for log in test}:
        raise InputError(f"--test {min(both)}: also fitted to; a log may be used for one of both only")
    if columns is None and experiment is None:
        _common_experiment([log / "steps.csv" if log.is_dir() else log for log in (*logs, *test)])
    tested = read_fit_data(test, columns, nominal, experiment, overrides)
    return tested.in_space(data.observed.space)


def without_suspicious(data: FitData) -> tuple[FitData, dict[str, str]]:
    """Leaves out rows with a number that lies far outside of the same numbers of all other rows.

    A few wrong numbers would decide which errors can be learned. The numbers are those of the state, the command, the
    next state, its prediction, and the error of this. Nothing is left out where so many rows would be that the others
    are no measure of them.

    Returns:
        The other rows, and what is suspicious in those that were left out, by their origins.
    """
    rows: dict[int, str] = {}
    for name, values in _numbers(data.steps):
        low, middle, high = np.quantile(values, (0.05, 0.5, 0.95), method="nearest")
        width = high - low or FAR_FROM_CONSTANT * abs(middle)
        far = np.maximum(low - values, values - high) > FAR * width
        if width > 0 and far.sum() <= MOST_SUSPICIOUS * len(values):
            for row in np.flatnonzero(far):
                rows.setdefault(int(row), f"{name} = {values[row]:.4g}, others {low:.3g} to {high:.3g}")
    if not 0 < len(rows) <= min(MOST_SUSPICIOUS * len(data.steps), len(data.steps) - LEAST_STEPS):
        return data, {}
    return data.without(rows), {str(data.origin[row]): rows[row] for row in sorted(rows)}


def _numbers(steps: Steps) -> Iterator[tuple[str, Array]]:
    """Yields the numbers by which a row may be suspicious, with their names."""
    state = steps.space.state_names
    yield from zip(state, steps.state.T, strict=True)
    yield from zip(steps.space.command_names, steps.requested.T, strict=True)
    yield from zip((f"next {name}" for name in state), steps.next_state.T, strict=True)
    yield from zip((f"predicted {name}" for name in state), steps.predicted.T, strict=True)
    yield from zip((f"error of {name}" for name in state), (steps.next_state - steps.predicted).T, strict=True)


def compare(
    kinds: Sequence[str],
    data: FitData,
    tested: FitData | None,
    folds: int | None,
    on_fit: OnFit = lambda done, total: None,
) -> Validation:
    """Scores residuals on `tested`, or without it on held-out parts of `data`, whose number is as of `choose_folds`.

    The other arguments are those of `validate`.
    """
    if tested is None:
        return validate(kinds, data.observed, choose_folds(data.steps, folds), on_fit)
    return validate_on(kinds, data.observed, tested.observed, on_fit)


def best_model(data: FitData, validation: Validation) -> str:
    """Model file of the residual that predicts best, fitted to all steps."""
    residual = fit_residual(validation.best.kind, data.observed)
    return saved_model_text(residual, data.observed.space, data.source)
