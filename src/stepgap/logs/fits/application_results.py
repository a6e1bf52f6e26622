"""Text, JSON and CSV output of `stepgap fit --load`: a saved model applied to recorded steps."""

import csv
from collections.abc import Mapping, Sequence
from io import StringIO
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from stepgap.logs.fits.fit_results import (
    WITH_SUSPICIOUS,
    describe_log,
    gain_sentence,
    gains_as_data,
    scores_as_data,
    show_scores,
)
from stepgap.logs.fits.model_application import AppliedModel

APPLIED_SCHEMA: Final = 3
"""Version of the JSON file with the scores."""


def describe_application(applied: AppliedModel) -> str:
    """A few lines on the steps, and on what the model knows of them."""
    space, residual = applied.data.observed.space, applied.residual
    unknown = [quantity.name for quantity in (*space.state, *space.command) if not quantity.unit]
    fitted = "no correction" if residual.kind == "none" else f"fitted to {len(residual.regressions[0].points)} steps"
    lines = [
        describe_log(applied.data),
        f"model       {residual.kind} of {applied.path}, {fitted}",
        f"outside     {applied.outside} steps outside the range of those that the model was fitted to",
    ]
    if unknown:
        lines.append(f"units       not compared for {', '.join(unknown)}: the steps have none")
    if applied.known:
        lines.append(f"known       {applied.known} steps that the model was fitted to: their errors are too small")
    return "\n".join(lines)


def show_application(scored: AppliedModel, stream: TextIO, with_suspicious: AppliedModel | None = None) -> None:
    """Prints a table for each state coordinate, and a sentence on the gain; this also with rows that are suspicious."""
    show_scores(scored.data.observed.space.state, scored.validation, stream)
    print(f"{'gain:':16}{_sentence(scored)}", file=stream)
    if with_suspicious:
        print(f"{WITH_SUSPICIOUS} {_sentence(with_suspicious)}", file=stream)


def _sentence(applied: AppliedModel) -> str:
    everything = range(len(applied.data.observed.space.state))
    return gain_sentence(applied.validation.reduction(applied.residual.kind, "none", everything))


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


def application_report(
    logs: Sequence[Path], scored: AppliedModel, applied: AppliedModel, suspicious: Mapping[str, str]
) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null.

    Args:
        logs: The logs.
        scored: The model applied to the steps without suspicious rows.
        applied: The model applied to all steps.
        suspicious: What is suspicious in the rows that were left out, by their origins.
    """
    state, kind = scored.data.observed.space.state, applied.residual.kind
    parts: dict[str, Sequence[int]] = {quantity.name: [index] for index, quantity in enumerate(state)}
    if len(state) > 1:
        parts["all together"] = range(len(state))
    return {
        "schema": APPLIED_SCHEMA,
        "logs": [str(log) for log in logs],
        "model": str(applied.path),
        "nominal": applied.data.nominal,
        "steps": len(scored.data.steps),
        "known_steps": applied.known,
        "steps_outside": applied.outside,
        "residuals": [
            {"kind": each, **scores_as_data(state, held)} for each, held in scored.validation.held_out.items()
        ],
        "gain": gains_as_data(scored.validation, kind, parts),
        "suspicious": dict(suspicious),
        "gain_with_suspicious": gains_as_data(applied.validation, kind, parts),
    }
