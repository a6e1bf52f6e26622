"""Text, JSON and CSV output of `stepgap fit --load`: a saved model applied to recorded steps."""

import csv
from collections.abc import Sequence
from io import StringIO
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from stepgap.logs.fits.fit_results import (
    describe_log,
    gain_sentence,
    lacking,
    reduction_as_data,
    scores_as_data,
    show_scores,
)
from stepgap.logs.fits.model_application import AppliedModel
from stepgap.step import Quantity

APPLIED_SCHEMA: Final = 1
"""Version of the JSON file with the scores."""

_WITHOUT: Final = "without a correction"


def describe_application(applied: AppliedModel) -> str:
    """A few lines on the steps, and on what the model knows of them."""
    space, residual = applied.data.observed.space, applied.residual
    drift = applied.data.learning.drift and residual.kind != "none"
    unknown = [quantity.name for quantity in (*space.state, *space.command) if not quantity.unit]
    fitted = "no correction" if residual.kind == "none" else f"fitted to {len(residual.regressions[0].points)} steps"
    lines = [
        describe_log(applied.data),
        f"model       {residual.kind} of {applied.path}, {fitted}",
        f"disturbance {'estimated from earlier steps' if drift else 'not estimated'}",
        f"outside     {applied.outside} steps outside the range of those that the model was fitted to",
    ]
    if unknown:
        lines.append(f"units       not compared for {', '.join(unknown)}: the steps have none")
    if applied.known:
        lines.append(f"known       {applied.known} steps that the model was fitted to: their errors are too small")
    return "\n".join(lines)


def show_application(applied: AppliedModel, stream: TextIO) -> None:
    """Prints a table for each state coordinate, and sentences on the gain."""
    state, steps = applied.data.observed.space.state, applied.data.steps
    show_scores(state, applied.validation, ["none"], stream)
    print(f"{'successive:':16}{lacking(state, applied.predicted, steps.follows)}", file=stream)
    for name, coordinates in _parts(state).items():
        print(f"{name + ':':16}{gain_sentence(applied.gain(coordinates), _WITHOUT)}", file=stream)


def _parts(state: Sequence[Quantity]) -> dict[str, Sequence[int]]:
    """State coordinates of each sentence."""
    parts: dict[str, Sequence[int]] = {quantity.name: [index] for index, quantity in enumerate(state)}
    return parts | ({"all together": range(len(state))} if len(state) > 1 else {})


def prediction_table(applied: AppliedModel) -> str:
    """CSV with a row for each step: what was measured, the nominal and the corrected next state, and its deviation."""
    steps, space, predicted = applied.data.steps, applied.data.observed.space, applied.predicted
    nominal = steps.predicted
    kinds = ("next", "nominal", "corrected", "std")
    columns = [f"{kind}_{name}" for kind in kinds for name in space.state_names]
    numbers = np.hstack(
        [steps.state, steps.requested, steps.next_state, nominal, nominal + predicted.mean, predicted.std]
    )
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["deployment", *space.names, *columns])
    writer.writerows([int(label), *row] for label, row in zip(steps.iteration, numbers.tolist(), strict=True))
    return text.getvalue()


def application_report(logs: Sequence[Path], applied: AppliedModel) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    state = applied.data.observed.space.state
    gains = {name: applied.gain(coordinates) for name, coordinates in _parts(state).items()}
    return {
        "schema": APPLIED_SCHEMA,
        "logs": [str(log) for log in logs],
        "model": str(applied.path),
        "nominal": applied.data.nominal,
        "steps": len(applied.data.steps),
        "known_steps": applied.known,
        "steps_outside": applied.outside,
        "residuals": [
            {"kind": kind, **scores_as_data(state, held)} for kind, held in applied.validation.held_out.items()
        ],
        "gain": {name: reduction_as_data(gain) for name, gain in gains.items()},
        "verdict": {name: gain_sentence(gain, _WITHOUT) for name, gain in gains.items()},
    }
