"""Text and JSON output of `stepgap fit`: tables, sentences and all numbers."""

from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from rich.text import Text

from stepgap.gauss.gaussian_process_fit import EXACT_SIZE
from stepgap.logs.fits.fit import Comparison, FitData
from stepgap.logs.fits.validation import Best, Folds, HeldOut, Reduction, Validation
from stepgap.logs.foreign_log import describe_left_out
from stepgap.records.text import with_unit
from stepgap.step import Array, Quantity

FIT_SCHEMA = 7
"""Version of the JSON file."""

_MOST_NAMED = 10
"""Largest number of suspicious rows that are named."""

LARGEST_CHANGE = 10.0
"""An error that is larger than another one by more than this multiple is far worse, whatever the number."""

WITH_SUSPICIOUS: Final = "with the suspicious rows:"
"""What a sentence begins with that counts all rows."""


def verdict(found: Comparison) -> str:
    """Sentence on the residual that predicts best; where suspicious rows were left out, also with these rows."""
    sentence = f"{'best:':16}{best_sentence(found.validation.best)}"
    return f"{sentence}\n{WITH_SUSPICIOUS} {best_sentence(found.with_them.best)}" if found.suspicious else sentence


def best_sentence(best: Best) -> str:
    """Sentence on which residual predicts best, by how much, and whether that is certain."""
    gain = "no residual predicts better" if best.kind == "none" else gain_sentence(best.gain)
    than = f"not certainly better than {', '.join(best.alike)}" if best.alike else "certainly better than all others"
    return f"{best.kind}, {gain}; {than}"


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
    parts = "parts of whole deployments" if folds.whole_deployments else "contiguous blocks"
    most = len(data.steps) - int(np.bincount(folds.fold).min() if test is None else 0)
    held_out = f"{folds.count} {parts}, one at a time" if test is None else f"{len(test.steps)} steps of other logs"
    return "\n".join(
        [
            describe_log(data),
            f"held out    {held_out}",
            *([f"processes   hyper-parameters from {EXACT_SIZE} of the steps, sparse"] if most > EXACT_SIZE else []),
        ]
    )


def describe_log(data: FitData) -> str:
    """A few lines on the steps that were read, and on their nominal next states."""
    steps, space = data.steps, data.observed.space
    deployments = len(steps.iterations)
    return "\n".join(
        [
            f"steps       {len(steps)} of {deployments} deployment{'s' if deployments > 1 else ''}; "
            f"rows left out: {describe_left_out(data.left_out)}",
            f"state       {', '.join(map(with_unit, space.state))}",
            f"command     {', '.join(map(with_unit, space.command))}",
            f"nominal     {data.nominal}",
        ]
    )


def show_validation(state: Sequence[Quantity], validation: Validation, stream: TextIO) -> None:
    """Prints a table for each state coordinate and one for all together: framed on a terminal, plain elsewhere."""
    show_scores(state, validation, stream)
    console = _console(stream)
    table = _table(console.is_terminal, "all together", "fit [s]")
    for kind, held in validation.held_out.items():
        table.add_row(kind, _format(held.seconds, ".2g"), _compared(validation, kind, range(len(state))))
    console.print(table)


def show_scores(state: Sequence[Quantity], validation: Validation, stream: TextIO) -> None:
    """Prints a table for each state coordinate."""
    console = _console(stream)
    for index, quantity in enumerate(state):
        table = _table(console.is_terminal, with_unit(quantity), "RMSE", "within 95 %")
        for kind, held in validation.held_out.items():
            scores = (_format(held.rmse[index], ".4g"), _format(100 * held.coverage[index], ".0f"))
            table.add_row(kind, *scores, _compared(validation, kind, [index]))
        console.print(table)


def _console(stream: TextIO) -> Console:
    """Console of a stream; wide if it is no terminal."""
    console = Console(file=stream, highlight=False)
    return console if console.is_terminal else Console(file=stream, highlight=False, width=200)


def _table(framed: bool, title: str, *scores: str) -> Table:
    """Empty table of residuals, which are compared with none in the last column."""
    table = Table(box=SIMPLE if framed else None, pad_edge=False)
    table.add_column(Text(title))
    for name in (*scores, "better than none"):
        table.add_column(Text(name), justify="right")
    return table


def _compared(validation: Validation, kind: str, coordinates: Sequence[int]) -> str:
    """Improvement of a residual over none."""
    by = validation.reduction(kind, "none", coordinates)
    return "–" if kind == "none" else _percent(by.value, by.half_width)


def _format(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"


def fit_report(logs: Sequence[Path], found: Comparison) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    data, validation = found.data, found.validation
    state = data.observed.space.state
    parts = {quantity.name: [index] for index, quantity in enumerate(state)} | {"all": range(len(state))}
    return {
        "schema": FIT_SCHEMA,
        "logs": [str(log) for log in logs],
        "nominal": data.nominal,
        "units": {quantity.name: quantity.unit for quantity in (*state, *data.observed.space.command)},
        "steps": len(data.steps),
        "left_out": dict(data.left_out),
        "folds": {"count": validation.folds.count, "whole_deployments": validation.folds.whole_deployments},
        "residuals": [
            {
                "kind": kind,
                **scores_as_data(state, held),
                "fit_seconds": held.seconds,
                "better_than": {"none": gains_as_data(validation, kind, parts)},
            }
            for kind, held in validation.held_out.items()
        ],
        "best": _best_as_data(validation.best),
        "suspicious": dict(found.suspicious),
        "best_with_suspicious": _best_as_data(found.with_them.best),
    }


def gains_as_data(validation: Validation, kind: str, parts: Mapping[str, Sequence[int]]) -> dict[str, Any]:
    """Reductions of the error without a correction as JSON-ready data, by the names of parts of the state."""
    return {name: _reduction_as_data(validation.reduction(kind, "none", part)) for name, part in parts.items()}


def _best_as_data(best: Best) -> dict[str, Any]:
    return {"kind": best.kind, "gain": _reduction_as_data(best.gain), "not_certainly_better_than": list(best.alike)}


def scores_as_data(state: Sequence[Quantity], held_out: HeldOut) -> dict[str, Any]:
    """Scores of predictions as JSON-ready data, by state coordinate."""
    return {"rmse": _named(state, held_out.rmse), "coverage": _named(state, held_out.coverage)}


def _reduction_as_data(by: Reduction) -> dict[str, Any]:
    """A reduction as JSON-ready data."""
    interval = [_finite(end) for end in by.interval]
    return {"value": _finite(by.value), "standard_error": _finite(by.standard_error), "interval": interval}


def _named(state: Sequence[Quantity], values: Array) -> dict[str, float | None]:
    """Numbers by state coordinate."""
    return {quantity.name: _finite(value) for quantity, value in zip(state, values, strict=True)}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
