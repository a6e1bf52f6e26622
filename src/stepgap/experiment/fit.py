"""Input and output of `stepgap fit`: the error of the nominal map in any log, and how much of it can be learned."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from rich.text import Text

from stepgap.base.errors import InputError
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.learning.residual import Residual
from stepgap.learning.step_log import StepLog, joined
from stepgap.learning.step_table import StepTable, describe_left_out, tabulate
from stepgap.learning.validation import (
    FOLDS,
    LEAST_STEPS,
    Folds,
    Reduction,
    Validation,
    contiguous_folds,
    deployment_folds,
    fit_steps,
)
from stepgap.records.columns import Columns
from stepgap.records.foreign_log import read_foreign_logs
from stepgap.records.steps_csv import RecordError, read_step_log
from stepgap.step import Array, Quantity, StepSpace

FIT_SCHEMA = 1
"""Version of the JSON file."""

MOST_STEPS = 2000
"""Largest number of steps; fits to more would take hours."""

BASELINES: tuple[str, ...] = ("none", "constant")
"""Residuals with which all others are compared."""

NOMINALS = {
    "map": "the robot's nominal map",
    "predicted": "the predictions in the log",
    "target": "the target, which is the prediction of a controller's map",
    "state": "the state, as if a step did not change it",
}
"""Sources of the nominal next states, with descriptions."""

Settings = Sequence[tuple[str, str]]
"""Dotted names and values."""


@dataclass(frozen=True, eq=False)
class FitData:
    """Steps to which residuals are fitted.

    Attributes:
        steps: Steps with the nominal next states as predictions.
        nominal: Description of the source of these predictions.
    """

    steps: StepTable
    nominal: str


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
    if nominal not in (None, "map") and (experiment or overrides):
        raise InputError(f"--nominal {nominal}: it has no settings; leave them out")
    if columns is None:
        logs = [log / "steps.csv" if log.is_dir() else log for log in logs]
        experiment = experiment or _common_experiment(logs)
    settings = read_experiment(experiment, overrides)
    space = settings.robot.space
    steps = _read_runs(logs, space) if columns is None else read_foreign_logs(logs, columns)
    source = nominal or _nominal_of(steps, space)
    description = NOMINALS[source]
    predicted = {"target": steps.target, "state": steps.state}.get(source, steps.predicted)
    if source == "map":
        steps = replace(steps, space=_same_names(steps.space, space))
        predicted = load_nominal(settings).map.evaluate(steps.state, steps.command).next_state
        description += f" with the settings of {experiment}" if experiment else " with default settings"
        description += ", some overridden" if overrides else ""
    if predicted is None:
        raise InputError(f"--nominal {source}: the log has none; name its columns by --{source}")
    steps = steps.with_predictions(predicted, "for which the nominal map predicts a failure")
    if not LEAST_STEPS <= len(steps) <= MOST_STEPS:
        raise InputError(
            f"{', '.join(map(str, logs))}: {len(steps)} usable steps, but there must be {LEAST_STEPS} to {MOST_STEPS}; "
            f"rows left out: {describe_left_out(steps.left_out)}"
        )
    return FitData(steps, description)


def _common_experiment(logs: Sequence[Path]) -> Path | None:
    """Settings in the folders of the logs, if they describe the same nominal map."""
    files = [log.with_name("experiment.toml") if log.with_name("experiment.toml").is_file() else None for log in logs]
    maps = [(read.robot.as_modelled, read.nominal) for read in map(read_experiment, files)]
    for log, found in zip(logs, maps, strict=True):
        if found != maps[0]:
            raise InputError(f"{log}: recorded with another robot or nominal map than {logs[0]}; give --experiment")
    return files[0]


def _read_runs(logs: Sequence[Path], space: StepSpace) -> StepTable:
    """Reads the steps of runs; their deployments are numbered consecutively over all runs."""
    found: list[StepLog] = []
    for path in logs:
        try:
            found.append(read_step_log(path, space))
        except OSError as error:
            raise InputError(
                f"{path}: {error.strerror}; give the folder of a run, its steps.csv, or a CSV file"
            ) from None
        except RecordError as error:
            raise InputError(f"{error}; for any other CSV file name its columns, see --help") from None
    return tabulate(joined(found))


def _nominal_of(steps: StepTable, space: StepSpace) -> str:
    """Source of the nominal next states if none is given."""
    if steps.predicted is not None:
        return "predicted"
    if space.has_names_of(steps.space):
        return "map"
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


def choose_folds(steps: StepTable, count: int | None) -> Folds:
    """Folds of whole deployments if there are several and no count is given, otherwise `count` contiguous blocks."""
    if count is None and len(np.unique(steps.deployment)) > 1:
        return deployment_folds(steps.deployment)
    if count is not None and not 2 <= count <= len(steps):
        raise InputError(f"--folds {count}: it must lie between 2 and the number of steps, {len(steps)}")
    return contiguous_folds(len(steps), count or FOLDS)


def best_residual(steps: StepTable, validation: Validation) -> Residual:
    """The best residual for all coordinates together, fitted to all steps."""
    return fit_steps(validation.best(range(len(steps.space.state))), steps)


# Text output


def verdicts(state: Sequence[Quantity], validation: Validation) -> str:
    """One sentence for each state coordinate, and one for all together."""
    lines = [f"{quantity.name + ':':16}{verdict(validation, [index])}" for index, quantity in enumerate(state)]
    together = [f"{'all together:':16}{verdict(validation, range(len(state)))}"] if len(state) > 1 else []
    return "\n".join(lines + together)


def verdict(validation: Validation, coordinates: Sequence[int]) -> str:
    """Sentence on the best residual for these state coordinates, and how much better it is than the baselines."""
    chosen = validation.best(coordinates)
    if chosen in BASELINES:
        nearest = validation.nearest(chosen, coordinates)
        closest = f"the closest, {nearest}, is {_compared(validation.reduction(nearest, chosen, coordinates), chosen)}"
        if chosen == "none":
            return f"nothing to learn: no residual is significantly better than none ({closest})"
        better = _compared(validation.reduction("constant", "none", coordinates), "none")
        return f"constant is {better}; no residual is better than the constant: nothing more to learn ({closest})"
    constant, none = (_compared(validation.reduction(chosen, other, coordinates), other) for other in BASELINES[::-1])
    last = chosen == list(validation.held_out)[-1]
    return f"{chosen} is {constant}, {none}" + ("" if last else "; no more complex residual is significantly better")


def _compared(by: Reduction, other: str) -> str:
    """A reduction as text; ± is one standard error."""
    return f"{'better' if by.value >= 0 else 'worse'} than {other} by {_percent(abs(by.value), by.standard_error)}"


def _percent(value: float, standard_error: float) -> str:
    if not np.isfinite([value, standard_error]).all():
        return "–"
    form = "z.0f" if standard_error >= 0.0095 else "z.1f"
    return f"{100 * value:{form}} ± {100 * standard_error:{form}} %"


def describe_fit_data(data: FitData, folds: Folds) -> str:
    """A few lines on the steps that were read, and on the parts that are held out."""
    steps, space = data.steps, data.steps.space
    deployments = len(np.unique(steps.deployment))
    parts = "parts of whole deployments" if folds.whole_deployments else "contiguous blocks"
    return "\n".join(
        [
            f"steps       {len(steps)} of {deployments} deployment{'s' if deployments > 1 else ''}; "
            f"rows left out: {describe_left_out(steps.left_out)}",
            f"state       {', '.join(map(_with_unit, space.state))}",
            f"command     {', '.join(map(_with_unit, space.command))}",
            f"nominal     {data.nominal}",
            f"held out    {folds.count} {parts}, one at a time",
        ]
    )


def show_validation(state: Sequence[Quantity], validation: Validation, stream: TextIO) -> None:
    """Prints a table for each state coordinate and one for all together: framed on a terminal, plain elsewhere."""
    console = Console(file=stream, highlight=False)
    if not console.is_terminal:
        console = Console(file=stream, highlight=False, width=200)
    framed = console.is_terminal
    for index, quantity in enumerate(state):
        table = _table(framed, _with_unit(quantity), "RMSE", "log density", "within 95 %")
        for kind, held in validation.held_out.items():
            scores = (_format(held.rmse[index], ".4g"), _format(held.log_density[index], ".2f"))
            table.add_row(
                kind, *scores, _format(100 * held.coverage[index], ".0f"), *_compared_all(validation, kind, [index])
            )
        console.print(table)
    table = _table(framed, "all together", "fit [s]")
    for kind, held in validation.held_out.items():
        table.add_row(kind, _format(held.seconds, ".2g"), *_compared_all(validation, kind, range(len(state))))
    console.print(table)


def _table(framed: bool, title: str, *scores: str) -> Table:
    """Empty table of residuals whose last columns compare them with the baselines."""
    table = Table(box=SIMPLE if framed else None, pad_edge=False)
    table.add_column(Text(title))
    for name in (*scores, *(f"better than {other}" for other in BASELINES)):
        table.add_column(Text(name), justify="right")
    return table


def _compared_all(validation: Validation, kind: str, coordinates: Sequence[int]) -> list[str]:
    """Improvement of a residual over each baseline."""
    by = [validation.reduction(kind, other, coordinates) for other in BASELINES]
    return [
        "–" if kind == other else _percent(one.value, one.standard_error)
        for one, other in zip(by, BASELINES, strict=True)
    ]


def _format(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"


def _with_unit(quantity: Quantity) -> str:
    return f"{quantity.name} [{quantity.unit}]" if quantity.unit else quantity.name


def fit_report(logs: Sequence[Path], data: FitData, validation: Validation) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    steps, state = data.steps, data.steps.space.state
    parts = {quantity.name: [index] for index, quantity in enumerate(state)} | {"all": range(len(state))}

    def named(values: Array) -> dict[str, float | None]:
        return {quantity.name: _finite(value) for quantity, value in zip(state, values, strict=True)}

    def better(kind: str, other: str) -> dict[str, Any]:
        by = {name: validation.reduction(kind, other, part) for name, part in parts.items()}
        return {n: {"value": _finite(r.value), "standard_error": _finite(r.standard_error)} for n, r in by.items()}

    return {
        "schema": FIT_SCHEMA,
        "logs": [str(log) for log in logs],
        "nominal": data.nominal,
        "units": {quantity.name: quantity.unit for quantity in (*state, *steps.space.command)},
        "steps": len(steps),
        "left_out": dict(steps.left_out),
        "folds": {"count": validation.folds.count, "whole_deployments": validation.folds.whole_deployments},
        "residuals": [
            {
                "kind": kind,
                "rmse": named(held.rmse),
                "log_density": named(held.log_density),
                "coverage": named(held.coverage),
                "fit_seconds": held.seconds,
                "better_than": {other: better(kind, other) for other in BASELINES},
            }
            for kind, held in validation.held_out.items()
        ],
        "best": {name: validation.best(part) for name, part in parts.items()},
        "verdict": {name: verdict(validation, part) for name, part in parts.items()},
    }


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
