"""Input of `stepgap fit`: the error of the nominal map in any log, and what is held out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.learning.observations import Observations
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps, joined
from stepgap.logs.columns import Columns
from stepgap.logs.fits.model_averaging import averaged, common_weights
from stepgap.logs.fits.validation import (
    FOLDS,
    LEAST_STEPS,
    Folds,
    Reduction,
    Validation,
    contiguous_folds,
    deployment_folds,
    fit_steps,
    reduction,
)
from stepgap.logs.foreign_log import FoundSteps, describe_left_out, read_foreign_logs
from stepgap.records.model_files import MAP, NominalSource, saved_model_text
from stepgap.records.steps_csv import RecordError, read_step_log
from stepgap.step import Array, StepSpace, StepStatus

MOST_STEPS = 2000
"""Largest number of steps; fits to more would take hours."""

NOMINALS = {
    MAP: "the robot's nominal map",
    "predicted": "the predictions in the log",
    "target": "the target, which is the prediction of a controller's map",
    "state": "the state, as if a step did not change it",
}
"""Sources of the nominal next states, with descriptions."""

BASELINES: tuple[str, ...] = ("none", "constant")
"""Residuals with which all others are compared, besides that of the run."""

Settings = Sequence[tuple[str, str]]
"""Dotted names and values."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Steps to which residuals are fitted.

    Attributes:
        steps: Steps that ended with a next state, with the nominal next states as predictions.
        observed: Errors of these predictions.
        left_out: Number of excluded rows by reason, such as "that ended without a next state"; no zeros.
        nominal: Description of the source of the predictions.
        source: That source: its name is a key of `NOMINALS`.
        learning: Settings of learning; those of the run, if the steps are those of a run.
    """

    steps: Steps
    observed: Observations
    left_out: Mapping[str, int]
    nominal: str
    source: NominalSource
    learning: LearningSettings


def read_fit_data(
    logs: Sequence[Path], columns: Columns | None, nominal: str | None, experiment: Path | None, overrides: Settings
) -> FitData:
    """Reads steps to which residuals are fitted, as `read_nominal_errors`; there must be enough, and not too many.

    Raises:
        InputError: The arguments do not fit each other, or the steps are too few or too many.
        RecordError: The content of a log is wrong.
    """
    data = read_nominal_errors(logs, columns, nominal, experiment, overrides)
    check_count(logs, data, LEAST_STEPS, MOST_STEPS)
    return data


def check_count(logs: Sequence[Path], data: FitData, least: int, most: int) -> None:
    """Raises InputError if there are too few or too many steps."""
    count = len(data.steps)
    if not least <= count <= most:
        found = f"{count} usable step{'' if count == 1 else 's'}, but there must be {least} to {most}"
        left_out = describe_left_out(data.left_out)
        raise InputError(f"{', '.join(map(str, logs))}: {found}; rows left out: {left_out}")


def read_nominal_errors(
    logs: Sequence[Path], columns: Columns | None, nominal: str | None, experiment: Path | None, overrides: Settings
) -> FitData:
    """Reads the steps of logs and computes their nominal next states.

    Args:
        logs: Run folders or their `steps.csv`; with `columns`, any CSV files.
        columns: Meaning of the columns of such files.
        nominal: A key of `NOMINALS`; None to choose by the content of the logs.
        experiment: Settings of the robot and of learning; None for those of the runs or, without runs, the defaults.
        overrides: Single settings that override these.

    Raises:
        InputError: The arguments do not fit each other.
        RecordError: The content of a log is wrong.
    """
    of_map = [name for name, _ in overrides if not name.startswith("learning.")]
    if nominal not in (None, MAP) and (experiment or of_map):
        raise InputError(f"--nominal {nominal}: it has no settings but those of learning; leave the others out")
    if columns is None:
        logs = [log / "steps.csv" if log.is_dir() else log for log in logs]
        experiment = experiment or _common_experiment(logs)
    settings = read_experiment(experiment, overrides)
    space = settings.robot.space
    found = _read_runs(logs, space) if columns is None else read_foreign_logs(logs, columns)
    steps, source = found.steps, nominal or _nominal_of(found.steps, space)
    description, step_map = NOMINALS[source], None
    predicted = {"target": steps.target, "state": steps.state}.get(source, steps.predicted)
    if source == MAP:
        found = found._replace(steps=steps.in_space(_same_names(steps.space, space)))
        step_map = load_nominal(settings).map
        predicted = step_map.evaluate(steps.state, steps.requested).next_state
        description += f" with the settings of {experiment}" if experiment else " with default settings"
        description += ", some overridden" if of_map else ""
    elif len(steps) and np.isnan(predicted).all():
        raise InputError(f"--nominal {source}: the log has none; name its columns by --{source}")
    return _with_errors(found, predicted, description, NominalSource(source, step_map), settings.learning)


def _with_errors(
    found: FoundSteps, predicted: Array, nominal: str, source: NominalSource, learning: LearningSettings
) -> FitData:
    """The steps that have a nominal next state (N, n), and its errors; arguments as of `FitData`."""
    known, left_out = np.flatnonzero(np.isfinite(predicted).all(axis=1)), dict(found.left_out)
    if failed := len(predicted) - len(known):
        left_out["for which the nominal map predicts a failure"] = failed
    steps = found.steps.with_columns(predicted=predicted).selected(known)
    error, phase = steps.next_state - steps.predicted, found.phase[known]
    arrays = steps.state, steps.requested, error
    observed = Observations(steps.space, *arrays, phase=phase, deployment=steps.iteration)
    return FitData(steps, observed, left_out, nominal, source, learning)


def _common_experiment(logs: Sequence[Path]) -> Path | None:
    """Settings in the folders of the logs, if they describe the same nominal map."""
    files = [log.with_name("experiment.toml") if log.with_name("experiment.toml").is_file() else None for log in logs]
    maps = [(read.robot.as_modelled, read.nominal) for read in map(read_experiment, files)]
    for log, found in zip(logs, maps, strict=True):
        if found != maps[0]:
            raise InputError(f"{log}: recorded with another robot or nominal map than {logs[0]}; give --experiment")
    return files[0]


def _read_runs(logs: Sequence[Path], space: StepSpace) -> FoundSteps:
    """Reads the steps of runs; their deployments are numbered consecutively over all runs.

    Their predictions are omitted: they may be those of a corrected map.
    """
    found: list[Steps] = []
    for path in logs:
        try:
            found.append(read_step_log(path, space))
        except OSError as error:
            raise InputError(
                f"{path}: {error.strerror}; give the folder of a run, its steps.csv, or a CSV file"
            ) from None
        except RecordError as error:
            raise InputError(f"{error}; for any other CSV file name its columns, see --help") from None
    steps = joined(found)
    done, left_out = steps.status == StepStatus.OK, {"that ended without a next state": steps.failed_steps}
    return FoundSteps(
        steps.with_columns(predicted=np.nan).selected(done), steps.phase[done], left_out if steps.failed_steps else {}
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


def _same_names(found: StepSpace, space: StepSpace) -> StepSpace:
    """The robot's space, after a check that the columns have its names."""
    if space.has_names_of(found):
        return space
    names, wanted = ",".join(found.names), ",".join(space.names)
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
        test: Logs of the same kind.
        columns: As of `read_fit_data`.
        nominal: As of `read_fit_data`.
        experiment: As of `read_fit_data`.
        overrides: As of `read_fit_data`.

    Raises:
        InputError: A log is used for both, or is not of the same robot and nominal map; or as of `read_fit_data`.
        RecordError: As of `read_fit_data`.
    """
    if both := {log.resolve() for log in logs} & {log.resolve() for log in test}:
        raise InputError(f"--test {min(both)}: also fitted to; a log may be used for one of both only")
    if columns is None and experiment is None:
        _common_experiment([log / "steps.csv" if log.is_dir() else log for log in (*logs, *test)])
    found = read_fit_data(test, columns, nominal, experiment, overrides)
    return replace(found, observed=replace(found.observed, space=data.observed.space))


def gains(validation: Validation, coordinates: Sequence[int]) -> dict[str, Reduction]:
    """Reduction of the error of these state coordinates by the averaged prediction, over that of each baseline."""
    average, block = averaged(validation), validation.folds.block
    return {kind: reduction(average, validation.held_out[kind], block, coordinates) for kind in BASELINES}


def heaviest_residual(validation: Validation) -> str:
    """Name of the residual with the largest weight in all coordinates together; the simplest of equal ones."""
    weights = common_weights(validation)
    return max(weights, key=lambda kind: round(weights[kind], 6))


def best_model(data: FitData, validation: Validation) -> str:
    """Model file of the residual with the largest weight, fitted to all steps as before a further deployment."""
    kind = heaviest_residual(validation)
    residual = fit_steps(data.observed, replace(data.learning, residual=kind, lagged_inputs="none"))
    return saved_model_text(residual, data.observed.space, data.source)
