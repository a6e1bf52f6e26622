"""What was learnt, in numbers: hyper-parameters with their units, and how often the 95 % intervals held."""

import numpy as np

from stepgap.learning.gaussian_process import leave_one_out
from stepgap.records.run_folder import RunRecord
from stepgap.report.bands import INTERVAL, coverage
from stepgap.report.html import table, with_unit
from stepgap.report.learnt import Learnt, input_quantities, surprise
from stepgap.report.sentences import decimal


def learnt_sentences(record: RunRecord, learnt: Learnt | None) -> list[str]:
    """What models the error, and what the tables mean."""
    if learnt is None:
        last = record.shown_iterations[-1]
        why = "deployment 0 began with the map as it is" if last == 0 else f"there is no models/iteration_{last}.json"
        return [f"Nothing is said of the model: {why}."]
    said = f"Deployment {learnt.iteration} began with the residual '{learnt.residual.name}'"
    processes = learnt.processes
    if not processes:
        return [f"{said}, which is no Gaussian process and has no length scales."]
    return [
        f"{said}: for each state coordinate a Gaussian process of actual − nominal, fitted to the "
        f"{len(processes[0].values)} hops before; what the place added to the error is taken out, where it was clear.",
        "A length scale is the distance over which the error changes: one much longer than the range of the data means "
        "that this input hardly matters.",
        "Noise is what a hop repeated under equal conditions would scatter, as the model has it.",
    ]


def learnt_tables(record: RunRecord, learnt: Learnt | None) -> str:
    """Length scales by input, and the other numbers by state coordinate; nothing without Gaussian processes."""
    if learnt is None or not learnt.processes:
        return ""
    names = [f"for {quantity.name}" for quantity in record.space.state]
    rows = []
    for row, quantity in enumerate(input_quantities(record.space, learnt.residual.hindsight)):
        values = learnt.processes[0].points[:, row]
        scales = [process.hyper_parameters.length_scale[row] * process.input_scale[row] for process in learnt.processes]
        known = f"{decimal(values.min())} … {decimal(values.max())}"
        rows.append([with_unit(quantity), known, *map(decimal, scales)])
    lengths = table("Length scales, in the unit of each input", ["input", "range of the data", *names], rows)
    heads = ["process", "noise", "signal", "constant", "leave-one-out RMSE", "its spread [std]", "within 95 %"]
    return lengths + table("Gaussian processes, in the unit of each coordinate", heads, _processes(record, learnt))


def _processes(record: RunRecord, learnt: Learnt) -> list[list[str]]:
    rows = []
    for quantity, process in zip(record.space.state, learnt.processes, strict=True):
        left, found = surprise(process), process.hyper_parameters
        error = process.values - leave_one_out(process)[0]
        numbers = [found.noise_std, found.signal_std, process.coefficient, float(np.sqrt(np.mean(error**2)))]
        inside = f"{100 * float(np.mean(np.abs(left) <= INTERVAL)):.1f} %"
        rows.append([with_unit(quantity), *map(decimal, numbers), decimal(float(np.sqrt(np.mean(left**2)))), inside])
    return rows


def coverage_table(record: RunRecord) -> str:
    """How many next states the 95 % intervals held, drawn before each hop; nothing if there were no intervals."""
    rows = []
    for iteration in record.steps.iterations:
        held = [coverage(record.steps.of_iteration(iteration), row) for row in range(len(record.space.state))]
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
