"""Text and JSON output of `stepgap fit`: tables, sentences and all numbers."""

from collections.abc import Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any, TextIO

import numpy as np
from numpy.typing import NDArray
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table
from rich.text import Text

from stepgap.gauss.gaussian_process_fit import EXACT_SIZE
from stepgap.logs.fits.fit import BASELINES, Comparison, FitData, gains, heaviest_residual
from stepgap.logs.fits.model_averaging import averaged, correlation_of_successive, residual_weights
from stepgap.logs.fits.validation import Folds, HeldOut, Reduction, Validation
from stepgap.logs.foreign_log import describe_left_out
from stepgap.report.text import with_unit
from stepgap.step import Array, Quantity

FIT_SCHEMA = 5
"""Version of the JSON file."""

_MOST_NAMED = 10
"""Largest number of suspicious rows that are named."""

LARGEST_CHANGE = 10.0
"""An error that is larger than another one by more than this multiple is far worse, whatever the number."""


def verdicts(found: Comparison) -> str:
    """Weights and correlation of the remaining errors; a sentence for each state coordinate, and for all together.

    Where suspicious rows were left out, the same sentences follow for all rows.
    """
    state = found.data.observed.space.state
    follows = found.scored_last[-1].steps.follows
    lines = [f"{'weights:':16}{weight_sentence(state, found.validation)}"]
    lines.append(f"{'successive:':16}{lacking(state, averaged(found.validation), follows)}")
    for name, part in parts_of(state).items():
        lines.append(f"{name + ':':16}{verdict(found.validation, part)}")
    if found.suspicious:
        lines.append("with the suspicious rows:")
        lines += [f"{name + ':':16}{verdict(found.with_them, part)}" for name, part in parts_of(state).items()]
    return "\n".join(lines)


def parts_of(state: Sequence[Quantity]) -> dict[str, Sequence[int]]:
    """State coordinates of each sentence: each, and all together."""
    parts: dict[str, Sequence[int]] = {quantity.name: [index] for index, quantity in enumerate(state)}
    return parts | ({"all together": range(len(state))} if len(state) > 1 else {})


def describe_suspicious(rows: Mapping[str, str]) -> str:
    """A line that names the suspicious rows."""
    named = [f"{origin} ({reason})" for origin, reason in islice(rows.items(), _MOST_NAMED)]
    more = [f"and {len(rows) - _MOST_NAMED} more"] if len(rows) > _MOST_NAMED else []
    return f"suspicious  {len(rows)} row{'s' if len(rows) > 1 else ''}, left out below: {'; '.join([*named, *more])}"


def verdict(validation: Validation, coordinates: Sequence[int]) -> str:
    """Sentence on how much learning reduces the error of these state coordinates, in all and beyond a constant."""
    by = gains(validation, coordinates)
    return f"{gain_sentence(by['none'], 'without a correction')}; {gain_sentence(by['constant'], 'with a constant')}"


def gain_sentence(by: Reduction, other: str) -> str:
    """Sentence on a reduction of another error, with its 95 % interval."""
    if abs(by.value) <= by.half_width or not np.isfinite(by.half_width):
        wide = by.half_width > LARGEST_CHANGE and np.isfinite(by.half_width)
        size = f"within more than ± {100 * LARGEST_CHANGE:.0f} %" if wide else _percent(by.value, by.half_width)
        return f"no difference shown from the error {other} ({size})"
    if by.value < -LARGEST_CHANGE:
        return f"far worse than {other}"
    size = _percent(abs(by.value), by.half_width)
    return f"{size} {'less' if by.value > 0 else 'more'} error than {other}"


def lacking(state: Sequence[Quantity], held_out: HeldOut, follows: NDArray[np.bool_]) -> str:
    """Sentence on whether the remaining errors of predictions show that the state lacks something.

    What lasts longer than a step, and is not in the state, makes successive errors alike. Noise of the measured state,
    in which one step ends and the next one begins, makes their signs alternate where the state persists.
    """
    correlation, half = correlation_of_successive(held_out, follows)
    if not np.isfinite(half):
        return "too few successive steps to see whether the state lacks something that lasts"
    alike, alternating = (
        ", ".join(
            f"{quantity.name} {value:.2f} ± {half:.2f}"
            for quantity, value in zip(state, correlation, strict=True)
            if sign * value > half
        )
        for sign in (1, -1)
    )
    found = [f"are correlated ({alike}): the state lacks something that lasts"] if alike else []
    if alternating:
        found.append(f"alternate ({alternating}), as with noise of the measured state")
    return f"remaining errors of successive steps {', and '.join(found) or f'are not correlated (within ± {half:.2f})'}"


def weight_sentence(state: Sequence[Quantity], validation: Validation) -> str:
    """The largest weights of the residuals in the averaged prediction, by state coordinate."""
    weights, parts = residual_weights(validation), []
    for index, quantity in enumerate(state):
        ranked = sorted(weights, key=lambda kind: -weights[kind][index])[:3]
        shown = [f"{kind} {weights[kind][index]:.2f}" for kind in ranked if weights[kind][index] >= 0.05]
        parts.append(f"{quantity.name}: {', '.join(shown)}")
    return "; ".join(parts)


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
            f"disturbance {_disturbance(data)}",
            f"outliers    {'not learned from' if data.learning.reject_outliers else 'learned from, as other steps'}",
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


def _disturbance(data: FitData) -> str:
    """What is done about errors that depend on time and phase."""
    phase = data.observed.phase
    if not data.learning.remove_yaw_dependence:
        removed = "errors fitted with their yaw-dependent part"
    elif phase is None or not np.isfinite(phase).any():
        removed = "no yaw known, so no yaw-dependent part removed"
    else:
        removed = "yaw-dependent part removed from the errors before a fit"
    estimated = "estimated from earlier held-out steps" if data.learning.drift else "not estimated in held-out steps"
    return f"{removed}; the rest {estimated}"


def _compared_with(data: FitData, validation: Validation) -> list[str]:
    """Residuals with which all others are compared: the baselines and that of the run."""
    used = data.learning.residual
    return [*BASELINES, *([used] if used in validation.held_out and used not in BASELINES else [])]


def show_validation(data: FitData, validation: Validation, stream: TextIO) -> None:
    """Prints a table for each state coordinate and one for all together: framed on a terminal, plain elsewhere."""
    compared = _compared_with(data, validation)
    show_scores(data.observed.space.state, validation, compared, stream)
    console = _console(stream)
    headings = [f"better than {other}" for other in compared]
    table = _table(console.is_terminal, "all together", "fit [s]", *headings)
    for kind, held in validation.held_out.items():
        better = _compared_all(validation, kind, compared, range(len(data.observed.space.state)))
        table.add_row(kind, _format(held.seconds, ".2g"), *better)
    console.print(table)


def show_scores(state: Sequence[Quantity], validation: Validation, compared: Sequence[str], stream: TextIO) -> None:
    """Prints a table for each state coordinate.

    Args:
        state: State coordinates.
        validation: Predictions.
        compared: Residuals with which all others are compared.
        stream: Where to print.
    """
    console, headings = _console(stream), [f"better than {other}" for other in compared]
    for index, quantity in enumerate(state):
        table = _table(console.is_terminal, with_unit(quantity), "RMSE", "log density", "within 95 %", *headings)
        for kind, held in validation.held_out.items():
            scores = (_format(held.rmse[index], ".4g"), _format(held.log_density[index], ".2f"))
            inside = _format(100 * held.coverage[index], ".0f")
            table.add_row(kind, *scores, inside, *_compared_all(validation, kind, compared, [index]))
        console.print(table)


def _console(stream: TextIO) -> Console:
    """Console of a stream; wide if it is no terminal."""
    console = Console(file=stream, highlight=False)
    return console if console.is_terminal else Console(file=stream, highlight=False, width=200)


def _table(framed: bool, title: str, *scores: str) -> Table:
    """Empty table of residuals."""
    table = Table(box=SIMPLE if framed else None, pad_edge=False)
    table.add_column(Text(title))
    for name in scores:
        table.add_column(Text(name), justify="right")
    return table


def _compared_all(validation: Validation, kind: str, others: Sequence[str], coordinates: Sequence[int]) -> list[str]:
    """Improvement of a residual over each of the others."""
    by = [validation.reduction(kind, other, coordinates) for other in others]
    return [
        "–" if kind == other else _percent(one.value, one.half_width) for one, other in zip(by, others, strict=True)
    ]


def _format(value: float, form: str) -> str:
    return f"{value:{form}}" if np.isfinite(value) else "–"


def fit_report(logs: Sequence[Path], found: Comparison) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    data, validation = found.data, found.validation
    state = data.observed.space.state
    parts = {quantity.name: [index] for index, quantity in enumerate(state)} | {"all": range(len(state))}

    def better(kind: str, other: str) -> dict[str, Any]:
        by = {name: validation.reduction(kind, other, part) for name, part in parts.items()}
        return {name: reduction_as_data(reduction) for name, reduction in by.items()}

    return {
        "schema": FIT_SCHEMA,
        "logs": [str(log) for log in logs],
        "nominal": data.nominal,
        "units": {quantity.name: quantity.unit for quantity in (*state, *data.observed.space.command)},
        "steps": len(data.steps),
        "left_out": dict(data.left_out),
        "learning": {
            "residual": data.learning.residual,
            "drift": data.learning.drift,
            "remove_yaw_dependence": data.learning.remove_yaw_dependence,
        },
        "folds": {"count": validation.folds.count, "whole_deployments": validation.folds.whole_deployments},
        "residuals": [
            {
                "kind": kind,
                **scores_as_data(state, held),
                "fit_seconds": held.seconds,
                "better_than": {other: better(kind, other) for other in _compared_with(data, validation)},
            }
            for kind, held in validation.held_out.items()
        ],
        "weights": {kind: _named(state, weight) for kind, weight in residual_weights(validation).items()},
        "heaviest": heaviest_residual(validation),
        "gain_over": _gains_as_data(validation, parts),
        "verdict": {name: verdict(validation, part) for name, part in parts.items()},
        "suspicious": dict(found.suspicious),
        "gain_over_with_suspicious": _gains_as_data(found.with_them, parts),
        "verdict_with_suspicious": {name: verdict(found.with_them, part) for name, part in parts.items()},
    }


def _gains_as_data(validation: Validation, parts: Mapping[str, Sequence[int]]) -> dict[str, Any]:
    return {
        name: {kind: reduction_as_data(by) for kind, by in gains(validation, part).items()}
        for name, part in parts.items()
    }


def scores_as_data(state: Sequence[Quantity], held_out: HeldOut) -> dict[str, Any]:
    """Scores of predictions as JSON-ready data, by state coordinate."""
    scores = {"rmse": held_out.rmse, "log_density": held_out.log_density, "coverage": held_out.coverage}
    return {name: _named(state, values) for name, values in scores.items()}


def reduction_as_data(by: Reduction) -> dict[str, Any]:
    """A reduction as JSON-ready data."""
    interval = [_finite(end) for end in by.interval]
    return {"value": _finite(by.value), "standard_error": _finite(by.standard_error), "interval": interval}


def _named(state: Sequence[Quantity], values: Array) -> dict[str, float | None]:
    """Numbers by state coordinate."""
    return {quantity.name: _finite(value) for quantity, value in zip(state, values, strict=True)}


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
