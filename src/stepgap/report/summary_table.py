"""The table at the top of a report: errors before and after learning, noise floors and verdict, by coordinate."""

import numpy as np

from stepgap.experiment.run import Run
from stepgap.records.text import decimal, with_unit
from stepgap.report.html import table
from stepgap.report.verdict import Achievement
from stepgap.step import Array


def summary_table(run: Run) -> str:
    """HTML of the table, with a row for each coordinate that has targets; empty if no deployment is finished.

    Columns without any number are left out.
    """
    if not run.deployments:
        return ""
    found = Achievement(run)
    first, last = found.first.iteration, found.last.iteration
    compared = found.predicted or first != last
    about = "" if run.summary.noise_floor_measured else ", at most about"
    columns = {
        "coordinate": [with_unit(each) for each in run.space.state],
        **(_before(found) if compared else {}),
        f"{'after: ' * compared}RMSE of deployment {last} (95 % interval)": _with_ends(found.after, found.after_ends),
        "change": [found.change_in_words(row) for row in range(len(found.after))],
        f"{'after: ' * compared}steady RMSE": [decimal(value) for value in found.last.steady_rmse],
        f"noise floor{about} (95 % interval)": _with_ends(found.floor, run.noise_floor_interval),
        **({} if found.is_without_noise else _noise_alone(run)),
        "verdict": [found.verdict_in_words(row) for row in range(len(found.after))],
    }
    columns = {head: [cells[row] for row in found.rows] for head, cells in columns.items()}
    known = {head: cells for head, cells in columns.items() if set(cells) != {"–"}}
    return table("", list(known), list(zip(*known.values(), strict=True)))


def _before(found: Achievement) -> dict[str, list[str]]:
    if found.predicted:
        return {"before: RMSE of the nominal map's predictions": [decimal(value) for value in found.before]}
    return {f"before: RMSE of deployment {found.first.iteration}": [decimal(value) for value in found.before]}


def _noise_alone(run: Run) -> dict[str, list[str]]:
    """The noise floor at one phase, where the robot has one."""
    periodic, steps = run.steps.space.periodic, run.steps
    if periodic is None or not np.isfinite(steps.phase).any() or not run.summary.noise_floor_measured:
        return {}
    return {f"noise alone, at one {periodic.name}": [decimal(value) for value in run.noise_floor_same_phase]}


def _with_ends(values: Array, ends: Array) -> list[str]:
    """Numbers with the ends of their intervals (2, n), where these are known."""
    return [
        f"{decimal(value)} ({decimal(low)} to {decimal(high)})"
        if np.isfinite([value, low, high]).all()
        else decimal(value)
        for value, low, high in zip(values, *ends, strict=True)
    ]
