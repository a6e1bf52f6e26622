"""Text and JSON output of `stepgap fit`: tables, sentences and all numbers."""

from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from rich.box import SIMPLE
from rich.table import Table
from rich.text import Text

from stepgap.cli.screen import screen
from stepgap.gauss.gaussian_process_fit import EXACT_SIZE
from stepgap.logs.fits.fit import FitData
from stepgap.logs.fits.validation import Best, Folds, Reduction, Validation
from stepgap.logs.foreign_log import describe_left_out
from stepgap.records.text import with_unit
from stepgap.step import Array, Quantity

FIT_SCHEMA = 8  # Version of the JSON file
_MOST_NAMED = 10  # Largest number of suspicious rows that are named

LARGEST_CHANGE = 10.0
"""An error that is larger than another one by more than this multiple is far worse, whatever the number."""


def best_sentence(best: Best) -> str:
    """Sentence on which residual predicts best, by how much, and whether that is certain."""
    gain = "no residual predicts better" if best.kind == "none" else gain_sentence(best.gain)
    than = f"not certainly better than {', '.join(best.alike)}" if best.alike else "certainly better than all others"
    return f"{'best:':16}{best.kind}, {gain}; {than}"


def describe_suspicious(rows: Mapping[str, str]) -> str:
    """A line that names the suspicious rows."""
    named = [f"{origin} ({reason})" for origin, reason in islice(rows.items(), _MOST_NAMED)]
    more = [f"and {len(rows) - _MOST_NAMED} more"] if len(rows) > _MOST_NAMED else []
    return f"suspicious  {len(rows)} row{'s' if len(rows) > 1 else ''}, left out below: {'; '.join([*named, *more])}"


def gain_sentence(by: Reduction) -> str:
    """Sentence on a reduction of the error without a correction, with its 95 % interval."""
    if abs(by.value) <= by.half_width or not np.isfinite(by.half_width):
        wide = by.half_width > LARGEST_CHANGE and np.isfinite(by.half_width)
        size = f"within more than ± {100 * LARGEST_CHANGE:.0f} %" if wide else _percent(by.value, by.half_width)
        return f"no difference shown from the error without a correction ({size})"
    if by.value < -LARGEST_CHANGE:
        return "far worse than without a correction"
    size = _percent(abs(by.value), by.half_width)
    return f"{size} {'less' if by.value > 0 else 'more'} error than without a correction"


def _percent(value: float, half_width: float) -> str:
    if value < -LARGEST_CHANGE:
        return "far worse"
    if not np.isfinite([value, half_width]).all():
        return "–"
    form = "z.0f" if half_width >= 0.0095 else "z.1f"
    return f"{100 * value:{form}} ± {100 * half_width:{form}} %"


def describe_fit_data(data: FitData, folds: Folds, test: FitData | None = None) -> str:
    """A few lines on the steps that were read, and on those that are held out: parts of them, or other steps."""
    steps = data.steps
    space = data.observed.space
    deployments = len(steps.iterations)
    lines = [
        f"steps       {len(steps)} of {deployments} deployment{'s' if deployments > 1 else ''}; "
        f"rows left out: {describe_left_out(data.left_out)}",
        f"state       {', '.join(map(with_unit, space.state))}",
        f"command     {', '.join(map(with_unit, space.command))}",
        f"nominal     {data.nominal}",
    ]
    most_fitted = len(steps)
    if test is None:
        parts = "parts of whole deployments" if folds.whole_deployments else "contiguous blocks"
        lines.append(f"held out    {folds.count} {parts}, one at a time")
        most_fitted -= int(np.bincount(folds.fold).min())
    else:
        lines.append(f"held out    {len(test.steps)} steps of other logs")
    if most_fitted > EXACT_SIZE:
        lines.append(f"processes   hyper-parameters from {EXACT_SIZE} of the steps, sparse")
    return "\n".join(lines)


def show_validation(state: Sequence[Quantity], validation: Validation, stream: TextIO) -> None:
    """Prints a table for each state coordinate and one for all together: framed on a terminal, plain elsewhere."""
    console = screen(stream, plain_width=200)
    for index, quantity in enumerate(state):
        table = _table(console.is_terminal, with_unit(quantity), "RMSE", "within 95 %")
        for kind, held in validation.held_out.items():
            scores = (_format(held.rmse[index], ".4g"), _format(100 * held.coverage[index], ".0f"))
            table.add_row(kind, *scores, _compared(validation, kind, [index]))
        console.print(table)
    table = _table(console.is_terminal, "all together", "fit [s]")
    for kind, held in validation.held_out.items():
        table.add_row(kind, _format(held.seconds, ".2g"), _compared(validation, kind, range(len(state))))
    console.print(table)


def _table(framed: bool, title: str, *scores: str) -> Table:
    """Empty table of residuals, which are compared with none in the last column."""
    table = Table(box=SIMPLE if framed else None, pad_edge=False)
    table.add_column(Text(title))
    for name in (*scores, "better than none"):
        table.add_column(Text(name), justify="right")
    return table


def _compared(validation: Validation, kind: str, coordinates: Sequence[int]) -> str:
    by = validation.reduction(kind, "none", coordinates)
    return "–" if kind == "none" else _percent(by.value, by.half_width)


def _format(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"


def fit_report(
    logs: Sequence[Path], data: FitData, validation: Validation, suspicious: Mapping[str, str]
) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    state = data.observed.space.state
    command = data.observed.space.command
    parts = {quantity.name: [index] for index, quantity in enumerate(state)} | {"all": range(len(state))}
    best = validation.best
    return {
        "schema": FIT_SCHEMA,
        "logs": [str(log) for log in logs],
        "nominal": data.nominal,
        "units": {quantity.name: quantity.unit for quantity in (*state, *command)},
        "steps": len(data.steps),
        "left_out": dict(data.left_out),
        "folds": {"count": validation.folds.count, "whole_deployments": validation.folds.whole_deployments},
        "residuals": [
            {
                "kind": kind,
                "rmse": _named(state, held.rmse),
                "coverage": _named(state, held.coverage),
                "fit_seconds": held.seconds,
                "better_than": {
                    "none": {
                        name: _reduction_as_data(validation.reduction(kind, "none", part))
                        for name, part in parts.items()
                    }
                },
            }
            for kind, held in validation.held_out.items()
        ],
        "best": {
            "kind": best.kind,
            "gain": _reduction_as_data(best.gain),
            "not_certainly_better_than": list(best.alike),
        },
        "suspicious": dict(suspicious),
    }


def _reduction_as_data(by: Reduction) -> dict[str, Any]:
    interval = [_finite(end) for end in by.interval]
    return {"value": _finite(by.value), "standard_error": _finite(by.standard_error), "interval": interval}


def _named(state: Sequence[Quantity], values: Array) -> dict[str, float | None]:
    return {quantity.name: _finite(value) for quantity, value in zip(state, values, strict=True)}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
