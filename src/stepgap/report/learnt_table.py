"""What was learnt, in numbers: parameters of the residual with their units, and how often the 95 % intervals held."""

from typing import Final

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.regression import Parameter
from stepgap.records.run_folder import RunRecord
from stepgap.report.bands import interval_coverage
from stepgap.report.html import table, with_unit
from stepgap.report.learnt import Learnt, input_quantities
from stepgap.report.sentences import decimal
from stepgap.step import Array

UNIT_NOTES: Final = {
    "value": "in the unit of each coordinate",
    "input": "in the unit of each input",
    "value per input": "in the unit of each coordinate per unit of the input",
    "": "without unit",
}
"""What the units of a `Parameter` mean."""


def learnt_sentences(record: RunRecord, learnt: Learnt | None) -> list[str]:
    """What models the error, and what the tables mean."""
    if learnt is None:
        last = record.shown_iterations[-1]
        why = "deployment 0 began with the map as it is" if last == 0 else f"there is no models/iteration_{last}.json"
        return [f"Nothing is said of the model: {why}."]
    begun = f"Deployment {learnt.iteration} began with the residual '{learnt.residual.name}'"
    if not learnt.steps:
        return [f"{begun}: {learnt.residual.model.description}."]
    parameters = [parameter for each in learnt.residual.regressions for parameter in each.parameters()]
    return [
        f"{begun}: for each state coordinate {learnt.residual.model.description}, fitted to actual − nominal of the "
        f"{learnt.steps} hops before; what the place added to the error is taken out, where it was clear.",
        *dict.fromkeys(parameter.meaning for parameter in parameters if parameter.meaning),
    ]


def learnt_tables(record: RunRecord, learnt: Learnt | None) -> str:
    """Each parameter that belongs to the inputs, by input, and all others by state coordinate."""
    if learnt is None or not learnt.steps:
        return ""
    found = [{each.name: each for each in regression.parameters()} for regression in learnt.residual.regressions]
    names = list(dict.fromkeys(name for parameters in found for name in parameters))
    by_input = [name for name in names if any(np.ndim(each[name].value) for each in found if name in each)]
    tables = [_by_input(record, learnt, [each.get(name) for each in found]) for name in by_input]
    rest = [name for name in names if name not in by_input]
    heads = ["coordinate", *rest, "leave-one-out RMSE", "its spread [std]", "within 95 %"]
    rows = [
        [with_unit(quantity), *(_shown(each.get(name)) for name in rest), *_left_out(learnt, row)]
        for row, (quantity, each) in enumerate(zip(record.space.state, found, strict=True))
    ]
    return "".join(tables) + table("The model of each coordinate, in its unit", heads, rows)


def _by_input(record: RunRecord, learnt: Learnt, parameters: list[Parameter | None]) -> str:
    """A parameter that has a value for each input, of the regression of every state coordinate."""
    (name, _, unit, _), *_ = (parameter for parameter in parameters if parameter)
    rows = []
    for row, quantity in enumerate(input_quantities(record.space, learnt.residual.history_inputs)):
        values = learnt.residual.regressions[0].points[:, row]
        known = f"{decimal(values.min())} … {decimal(values.max())}"
        rows.append([with_unit(quantity), known, *(_shown(parameter, row) for parameter in parameters)])
    heads = ["input", "range of the data", *(f"for {quantity.name}" for quantity in record.space.state)]
    return table(f"{name[:1].upper()}{name[1:]}, {UNIT_NOTES[unit]}", heads, rows)


def _shown(parameter: Parameter | None, row: int = 0) -> str:
    """A number of a parameter; a dash where a regression does not have it."""
    return decimal(float(np.ravel(parameter.value)[row])) if parameter else "–"


def _left_out(learnt: Learnt, row: int) -> list[str]:
    """How well the regression of a state coordinate predicts each of its values from all others."""
    values, (mean, _) = learnt.residual.regressions[row].values, learnt.leave_one_out[row]
    standardised = learnt.standardised_errors[row]
    inside = f"{100 * float(np.mean(np.abs(standardised) <= INTERVAL_95)):.1f} %"
    return [decimal(_rms(values - mean)), decimal(_rms(standardised)), inside]


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def coverage_table(record: RunRecord) -> str:
    """How many next states the 95 % intervals held, drawn before each hop; nothing if there were no intervals."""
    rows = []
    for iteration in record.steps.iterations:
        held = [interval_coverage(record.steps.of_iteration(iteration), row) for row in range(len(record.space.state))]
        if any(known for _, known in held):
            rows.append(
                [str(iteration), *(f"{n} of {known} ({100 * n / known:.1f} %)" if known else "–" for n, known in held)]
            )
    if not rows:
        return ""
    return table(
        "Hops that ended within the 95 % interval predicted before they began",
        ["deployment", *record.space.state_names],
        rows,
    )
