"""A saved model applied to recorded steps: how large their errors are with and without it."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any, Final, TextIO

import numpy as np

from stepgap.base.errors import InputError, message_of
from stepgap.experiment.fit import FitData
from stepgap.experiment.fit_results import (
    describe_log,
    gain_sentence,
    lacking,
    reduction_as_data,
    scores_as_data,
    show_scores,
)
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.learning.validation import HeldOut, Reduction, Validation, reduction, validate_fitted
from stepgap.records.model_files import read_saved_model
from stepgap.step import Array, Quantity

LEAST_PREDICTED: Final = 2
"""Least number of steps to which a model is applied; one has no interval."""

MOST_PREDICTED: Final = 100_000
"""Largest number of steps to which a model is applied."""

APPLIED_SCHEMA: Final = 1
"""Version of the JSON file with the scores."""

_WITHOUT: Final = "without a correction"


@dataclass(frozen=True, eq=False)
class AppliedModel:
    """A model and the steps that it predicts.

    Attributes:
        path: The model file.
        residual: The model.
        data: The steps.
        validation: Predictions of the errors without a correction (`none`), and by the model.
    """

    path: Path
    residual: Residual
    data: FitData
    validation: Validation

    @property
    def predicted(self) -> HeldOut:
        """Predictions by the model."""
        return self.validation.held_out[self.residual.kind]

    @property
    def known(self) -> int:
        """Number of steps to which the model was fitted, by their state and command."""
        fitted = {tuple(point) for point in self.residual.regressions[0].points.tolist()}
        return sum(tuple(point) in fitted for point in self._points.tolist())

    @property
    def outside(self) -> int:
        """Number of steps outside the ranges of state and command in the steps to which the model was fitted."""
        fitted = self.residual.regressions[0].points
        if not len(fitted):
            return 0
        beyond = (self._points < fitted.min(axis=0)) | (self._points > fitted.max(axis=0))
        return int(beyond.any(axis=1).sum())

    def gain(self, coordinates: Sequence[int]) -> Reduction:
        """Reduction of the error of these state coordinates by the model."""
        folds = self.validation.folds
        return reduction(self.predicted, self.validation.held_out["none"], folds.block, coordinates)

    @property
    def _points(self) -> Array:
        return join_points(self.data.steps.state, self.data.steps.command)


def apply_model(path: Path, data: FitData) -> AppliedModel:
    """Predicts the errors of steps by a saved model, without training.

    Args:
        path: Model file of a run or of `stepgap fit --save`.
        data: The steps.

    Raises:
        InputError: The file is not a model, or not one of such steps and nominal next states; or its predictions
            need the history of a step, or are not finite.
    """
    try:
        residual = read_saved_model(path, data.steps.space, data.source)
    except (OSError, ValueError) as error:
        raise InputError(message_of(error)) from None
    if residual.history_inputs != HistoryInputs():
        raise InputError(
            f"{path}: has inputs of the step before or the time; `stepgap fit` applies models without them"
        )
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            validation = validate_fitted(residual, data.steps, data.learning)
    except (FloatingPointError, np.linalg.LinAlgError):
        raise InputError(f"{path}: its numbers are so large or small that predictions overflow") from None
    held_out = validation.held_out[residual.kind]
    if not np.isfinite([held_out.mean, held_out.std]).all():
        raise InputError(f"{path}: its predictions are not finite")
    return AppliedModel(path, residual, data, validation)


def describe_application(applied: AppliedModel) -> str:
    """A few lines on the steps, and on what the model knows of them."""
    steps, residual = applied.data.steps, applied.residual
    drift = applied.data.learning.drift and residual.kind != "none"
    unknown = [quantity.name for quantity in (*steps.space.state, *steps.space.command) if not quantity.unit]
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
    state, steps = applied.data.steps.space.state, applied.data.steps
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
    steps, space, predicted = applied.data.steps, applied.data.steps.space, applied.predicted
    nominal = np.array(steps.predicted, float)
    kinds = ("next", "nominal", "corrected", "std")
    columns = [f"{kind}_{name}" for kind in kinds for name in space.state_names]
    numbers = np.hstack(
        [steps.state, steps.command, steps.next_state, nominal, nominal + predicted.mean, predicted.std]
    )
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["deployment", *space.names, *columns])
    writer.writerows([int(label), *row] for label, row in zip(steps.deployment, numbers.tolist(), strict=True))
    return text.getvalue()


def application_report(logs: Sequence[Path], applied: AppliedModel) -> dict[str, Any]:
    """All results as JSON-ready data; NaN and infinities become null."""
    state = applied.data.steps.space.state
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
