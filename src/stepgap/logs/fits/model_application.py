"""A saved model applied to recorded steps: how large their errors are with and without it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.base.errors import InputError, message_of
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.logs.fits.fit import FitData
from stepgap.logs.fits.validation import HeldOut, Validation, validate_fitted
from stepgap.records.model_files import read_saved_model
from stepgap.step import Array

LEAST_PREDICTED: Final = 2
"""Least number of steps to which a model is applied; one has no interval."""

MOST_PREDICTED: Final = 100_000
"""Largest number of steps to which a model is applied."""


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

    @property
    def _points(self) -> Array:
        return join_points(self.data.observed.state, self.data.observed.command)


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
        residual = read_saved_model(path, data.observed.space, data.source)
    except (OSError, ValueError) as error:
        raise InputError(message_of(error)) from None
    if residual.history_inputs != HistoryInputs():
        raise InputError(
            f"{path}: has inputs of the step before or the time; `stepgap fit` applies models without them"
        )
    try:
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            validation = validate_fitted(residual, data.observed)
    except (FloatingPointError, np.linalg.LinAlgError):
        raise InputError(f"{path}: its numbers are so large or small that predictions overflow") from None
    held_out = validation.held_out[residual.kind]
    if not np.isfinite([held_out.mean, held_out.std]).all():
        raise InputError(f"{path}: its predictions are not finite")
    return AppliedModel(path, residual, data, validation)
