"""Input of `stepgap fit`: the error of the nominal map in any log, and what is held out."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.learning.observations import Observations
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.steps import Steps, joined
from stepgap.logs.columns import Columns
from stepgap.logs.fits.suspicious import MOST_SUSPICIOUS, Reasons, far_rows, improbable_rows
from stepgap.logs.fits.validation import (
    FOLDS,
    LEAST_STEPS,
    Folds,
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

MOST_STEPS = 100_000
"""Largest number of steps; those of a day of hopping."""

NOMINALS = {
    MAP: "the robot's nominal map",
    "predicted": "the predictions in the log",
    "target": "the target, which is the prediction of a controller's map",
    "state": "the state, as if a step did not change it",
}
"""Sources of the nominal next states, with descriptions."""

_MOST_ROUNDS = 4
"""Suspicious rows may hide others, so residuals are compared without them, at most this number of times."""

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

    def without(self, rows: Reasons) -> "FitData":
        """The data without some rows, with the ranges of the others."""
        kept = ~np.isin(np.arange(len(self.steps)), list(rows))
        found = replace(
            self,
            steps=self.steps.selected(kept),
            observed=self.observed.selected(kept),
            origin=self.origin[kept],
        )
        return found.in_space(self.columns.space(found.steps.state, found.steps.requested)) if self.columns else found

    def in_space(self, space: StepSpace) -> "FitData":
        """The same data with other ranges."""
        return replace(self, steps=self.steps.in_space(space), observed=replace(self.observed, space=space))

    def named(self, rows: Reasons) -> dict[str, str]:
        """What is suspicious in some rows, by their origins."""
        return {str(self.origin[row]): reason for row, reason in rows.items()}


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
        experiment: Settings of the robot; None for those of the runs or, without runs, the defaults.
        overrides: Single settings that override these.

    Raises:
        InputError: The arguments do not fit each other.
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
    found = _read_runs(logs, space) if columns is None else read_foreign_logs(logs, columns)
    steps, source = found.steps, nominal or _nominal_of(found.steps, space)
    description, step_map = NOMINALS[source], None
    predicted = {"target": steps.target, "state": steps.state}.get(source, steps.predicted)
    if source == MAP:
        found = found._replace(steps=steps.in_space(_same_names(steps.space, space)))
        step_map = load_nominal(settings).map
        predicted = step_map.evaluate(steps.state, steps.requested).next_state
        description += f" with the settings of {experiment}" if experiment else " with default settings"
        description += ", some overridden" if overrides else ""
    elif len(steps) and np.isnan(predicted).any(axis=1).all():
        some = "none" if np.isnan(predicted).all() else "no step with one for every state coordinate"
        raise InputError(f"--nominal {source}: the log has {some}; name its columns by --{source}")
    data = _with_errors(found, predicted, description, NominalSource(source, step_map))
    return data if source == MAP else replace(data, columns=columns)


def _with_errors(found: FoundSteps, predicted: Array, nominal: str, source: NominalSource) -> FitData:
    """The steps that have a nominal next state (N, n), and its errors; arguments as of `FitData`."""
    known, left_out = np.flatnonzero(np.isfinite(predicted).all(axis=1)), dict(found.left_out)
    if failed := len(predicted) - len(known):
        reason = "for which the nominal map predicts a failure" if source.step_map else f"without a whole {source.name}"
        left_out[reason] = failed
    steps = found.steps.with_columns(predicted=predicted).selected(known)
    observed = Observations(steps.space, steps.state, steps.requested, steps.next_state - steps.predicted)
    return FitData(steps, observed, found.origin[known], left_out, nominal, source)


def _common_experiment(logs: Sequence[Path]) -> Path | None:
    """Settings in the folders of the logs, if they describe the same nominal map."""
    files = [log.with_name("experiment.toml") if log.with_name("experiment.toml").is_file() else None for log in logs]
    read = [read_experiment(file, recorded=True) for file in files]
    maps = [(each.robot.as_modelled, each.nominal) for each in read]
    for log, found in zip(logs, maps, strict=True):
        if found != maps[0]:
            raise InputError(f"{log}: recorded with another robot or nominal map than {logs[0]}; give --experiment")
    return files[0]


def _read_runs(logs: Sequence[Path], space: StepSpace) -> FoundSteps:
    """Reads the steps of runs; their deployments are numbered as `joined` does.

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
    return found.in_space(data.observed.space)


@dataclass(frozen=True, eq=False)
class Comparison:
    """Residuals scored on held-out steps.

    Attributes:
        data: Steps to which they were fitted, without those that are suspicious.
        tested: Steps of other logs on which they were scored, likewise; None if parts of `data` were held out.
        validation: The predictions.
        suspicious: What is suspicious in the rows that were left out, by their origins.
        with_them: The predictions if these rows are not left out; the same as `validation` if there are none.
    """

    data: FitData
    tested: FitData | None
    validation: Validation
    suspicious: Mapping[str, str]
    with_them: Validation

    @property
    def scored_last(self) -> list[FitData]:
        """The steps that were fitted to, and those that were scored if they are others."""
        return [self.data] if self.tested is None else [self.data, self.tested]


def compare(
    kinds: Sequence[str],
    data: FitData,
    tested: FitData | None,
    folds: int | None,
    on_fit: Callable[[int, int], None] = lambda done, total: None,
) -> Comparison:
    """Scores residuals on held-out steps; rows that are suspicious are left out, until no more are found.

    Args:
        kinds: Names of the residuals, from simple to complex.
        data: Steps to which they are fitted.
        tested: Other steps on which they are scored; None to hold out parts of `data`.
        folds: Number of these parts; as of `choose_folds`.
        on_fit: Called with the number of fits done and the number of all fits.
    """

    def validated(data: FitData, tested: FitData | None) -> Validation:
        if tested is None:
            return validate(kinds, data.observed, choose_folds(data.steps, folds), on_fit)
        return validate_on(kinds, data.observed, tested.observed, on_fit)

    first = now = Comparison(data, tested, both := validated(data, tested), {}, both)
    for _ in range(_MOST_ROUNDS):
        rows = [far_rows(each.steps) for each in now.scored_last]
        if not any(rows):
            rows[-1] = improbable_rows(now.scored_last[-1].observed, now.scored_last[-1].steps.follows, now.validation)
        if not any(rows):
            break
        named = dict(now.suspicious)
        for each, of_each in zip(now.scored_last, rows, strict=True):
            named |= each.named(of_each)
        kept, *others = (each.without(of_each) for each, of_each in zip(now.scored_last, rows, strict=True))
        left = others[0].in_space(kept.observed.space) if others else None
        now = Comparison(kept, left, validated(kept, left), named, both)
    count = sum(len(each.steps) for each in first.scored_last)
    return now if len(now.suspicious) <= 2 * MOST_SUSPICIOUS * count else first


def best_model(data: FitData, validation: Validation) -> str:
    """Model file of the residual that predicts best, fitted to all steps."""
    residual = fit_residual(validation.best.kind, data.observed)
    return saved_model_text(residual, data.observed.space, data.source)
