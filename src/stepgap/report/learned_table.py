"""Tables of the learned residual: its parameters with units, and the coverage of its 95 % intervals."""

from typing import Final

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.experiment.bands import interval_coverage
from stepgap.experiment.run import Run
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.regression import Parameter
from stepgap.records.missing import Missing
from stepgap.records.text import decimal, with_unit
from stepgap.report.analysis import Analysis, input_quantities
from stepgap.report.html import table
from stepgap.report.learned_residual import LearnedResidual
from stepgap.step import Array

UNIT_NOTES: Final = {
    "value": "in the unit of each coordinate",
    "input": "in the unit of each input",
    "value per input": "in the unit of each coordinate per unit of the input",
    "": "without unit",
}
"""Meaning of the units of a `Parameter`."""


def learned_sentences(analysis: Analysis) -> list[str]:
    """Sentences on the model of the error, and on the meaning of the tables."""
    run = analysis.run
    learned = analysis.learned
    if isinstance(learned, Missing):
        return [f"There is no model to describe: {learned.reason}."]
    name = f"the residual '{learned.residual.kind}'"
    model = f"Deployment {learned.iteration} began with {name}"
    if learned.iteration > run.shown_iterations[-1]:
        model = f"Deployment {learned.iteration - 1} learned while it ran. A further deployment would begin with {name}"
    if not learned.steps:
        return [f"{model}: {learned.residual.model.description}."]
    parameters = [parameter for regression in learned.residual.regressions for parameter in regression.parameters()]
    believed = learned.residual.kind == POSTERIOR.name
    periodic = run.steps.space.periodic
    besides = f"what returns with the {periodic.name}, and " if periodic and np.isfinite(run.steps.phase).any() else ""
    return [
        f"{model}: for each state coordinate {learned.residual.model.description}, "
        f"{'learned from' if believed else 'fitted to'} actual − nominal of {learned.steps} earlier steps.",
        *([f"Figures and tables are without {besides}what follows from the step before."] if believed else []),
        *dict.fromkeys(parameter.meaning for parameter in parameters if parameter.meaning),
    ]


def learned_tables(run: Run, learned: LearnedResidual | Missing) -> str:
    """Tables of the parameters: those with a value for each input by input, all others by state coordinate."""
    if isinstance(learned, Missing) or not learned.steps:
        return ""
    regressions = learned.residual.regressions
    models = [{parameter.name: parameter for parameter in regression.parameters()} for regression in regressions]
    names = list(dict.fromkeys(name for parameters in models for name in parameters))
    by_input = [name for name in names if any(np.ndim(model[name].value) for model in models if name in model)]
    tables = [_by_input(run, learned, [model.get(name) for model in models]) for name in by_input]
    rest = [name for name in names if name not in by_input]
    heads = ["coordinate", *rest, "leave-one-out RMSE", "RMS of error / std", "within 95 %"]
    rows = [
        [with_unit(quantity), *(_format(model.get(name)) for name in rest), *_left_out(learned, row)]
        for row, (quantity, model) in enumerate(zip(run.space.state, models, strict=True))
    ]
    return "".join(tables) + table("The model of each coordinate, in its unit", heads, rows)


def _by_input(run: Run, learned: LearnedResidual, parameters: list[Parameter | None]) -> str:
    """Table of a parameter with a value for each input, for the regressions of all state coordinates."""
    (name, _, unit, _), *_ = (parameter for parameter in parameters if parameter)
    rows = []
    for row, quantity in enumerate(input_quantities(run.space, learned.residual.history_inputs)):
        values = learned.residual.regressions[0].points[:, row]
        ends = f"{decimal(values.min())} … {decimal(values.max())}"
        rows.append([with_unit(quantity), ends, *(_format(parameter, row) for parameter in parameters)])
    heads = ["input", "range of the data", *(f"for {quantity.name}" for quantity in run.space.state)]
    return table(f"{name[:1].upper()}{name[1:]}, {UNIT_NOTES[unit]}", heads, rows)


def _format(parameter: Parameter | None, row: int = 0) -> str:
    """Text of a number of a parameter; a dash where a regression does not have the parameter."""
    return decimal(float(np.ravel(parameter.value)[row])) if parameter else "–"


def _left_out(learned: LearnedResidual, row: int) -> list[str]:
    """Errors and coverage of the leave-one-out predictions for a state coordinate."""
    values = learned.residual.regressions[row].values
    mean, _ = learned.leave_one_out[row]
    standardised = learned.standardised_errors[row]
    inside = f"{100 * float(np.mean(np.abs(standardised) <= INTERVAL_95)):.1f} %"
    return [decimal(_rms(values - mean)), decimal(_rms(standardised)), inside]


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def coverage_table(run: Run) -> str:
    """Table of the coverage of the 95 % prediction intervals by deployment; empty if there were no intervals."""
    rows = []
    for iteration in run.steps.iterations:
        held = list(zip(*interval_coverage(run.steps.of_iteration(iteration)), strict=True))
        if any(count for _, count in held):
            cells = [f"{n} of {count} ({100 * n / count:.1f} %)" if count else "–" for n, count in held]
            rows.append([str(iteration), *cells])
    heads = ["deployment", *run.space.state_names]
    return table("Steps that ended within their 95 % prediction interval", heads, rows) if rows else ""
