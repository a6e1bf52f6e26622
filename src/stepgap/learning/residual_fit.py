"""Fits residuals to observations: with a given model, or with the one that predicts best what it was not fitted to."""

import math
from collections.abc import Mapping
from math import inf
from typing import Any

import numpy as np

from stepgap.base.json_data import integer, number
from stepgap.base.normal import log_density
from stepgap.learning.entry_points import load_residual_model, residual_models
from stepgap.learning.observations import Observations
from stepgap.learning.regression import Regression, ResidualModel
from stepgap.learning.residual import HistoryInputs, Residual, no_residual
from stepgap.learning.residual_check import check_regression, failed, naming_model
from stepgap.learning.settings import AUTO
from stepgap.learning.zero import NONE

SELECTION_FOLDS = 5
"""Number of contiguous parts of the record, each predicted from the others, by which `auto` chooses."""

LARGEST_DIMENSION = 100
"""Largest number of state coordinates, of command coordinates, and of inputs of a regression that is read."""


def fit_residual(residual: str | ResidualModel, observations: Observations, forgetting_time: float = inf) -> Residual:
    """Fits a model of the nominal map's error (Eq. 12).

    `auto` selects the installed candidate with the best `held_out_score`; of equally good ones the simplest.

    Args:
        residual: Name of an installed model, `auto`, or a model itself.
        forgetting_time: As in `HistoryInputs` [steps].

    Raises:
        InputError: There is no model of this name, or it cannot be used.
        ResidualError: The model failed, or what it returned is not valid.
        ValueError: There is nothing to learn from.
    """
    space = observations.space
    if isinstance(residual, ResidualModel):
        models = [residual]
    elif residual == AUTO:
        models = [model for model in residual_models() if model.candidate]
    else:
        models = [load_residual_model(residual)]
    if not len(observations):
        if residual == AUTO or models == [NONE]:
            return no_residual(len(space.state), len(space.command))
        raise ValueError(f"residual {models[0].name!r} needs at least one step")

    inputs = HistoryInputs(forgetting_time, observations.context_inputs)
    fits = [_fit(model, inputs, observations) for model in models]
    if len(fits) == 1:
        return fits[0]
    # The models are in the order of their complexity, and `max` returns the first of equals.
    return max(fits, key=lambda fit: held_out_score(fit, observations))


def held_out_score(residual: Residual, observations: Observations) -> float:
    """Score of a residual in cross-validation: each error is predicted from those outside its part of the record.

    The parts are contiguous because neighbouring steps are alike. A flexible model would predict a single step well
    from the steps beside it, but the steps of the next deployment have none beside them in the record. The steps in the
    middle of a part are like those: all steps beside them are held out, too.

    Args:
        residual: Residual fitted to the observations.
        observations: The N observations; if there are fewer than `SELECTION_FOLDS`, every one is a part of its own.

    Returns:
        Mean log predictive density of an error, summed over the coordinates; −inf where a prediction is missing.
    """
    parts = np.array_split(np.arange(len(observations)), min(SELECTION_FOLDS, len(observations)))
    blocks = [slice(part[0], part[-1] + 1) for part in parts]
    score = 0.0
    for regression, error in zip(residual.regressions, observations.error.T, strict=True):
        mean, std = regression.left_out(blocks)
        score += float(np.mean(log_density(error - mean, std)))
    return score if math.isfinite(score) else -math.inf


def residual_from_dict(data: Mapping[str, Any]) -> Residual:
    """Restores the residual that `to_dict` saved, with the installed model that it names.

    Raises:
        InputError: The model is not installed, or cannot be used.
        ValueError: A key is missing or its value is not valid; the message names it.
    """
    kind = data.get("kind")
    if not isinstance(kind, str):
        raise ValueError(f"kind must be the name of a residual, not {kind!r:.40}")
    saved = data.get("regressions")
    if not isinstance(saved, list) or not saved:
        raise ValueError("regressions must be a list of one regression per state coordinate")
    command_size = integer(data, "command_size")
    if max(len(saved), command_size) > LARGEST_DIMENSION:
        raise ValueError(f"{len(saved)} regressions, command_size {command_size}: must be at most {LARGEST_DIMENSION}")
    model = load_residual_model(kind)
    regressions = tuple(_regression(model, item, f"regressions[{row}]") for row, item in enumerate(saved))
    return Residual(model, regressions, command_size, _history_inputs(data))


def _fit(model: ResidualModel, history_inputs: HistoryInputs, observations: Observations) -> Residual:
    """Fits one regression for each state coordinate; all of them are fitted to the same points."""
    n = len(observations.space.state)
    m = len(observations.space.command)
    data = [observations.training_data(history_inputs, coordinate) for coordinate in range(n)]
    with naming_model(model):
        residual = Residual(model, tuple(model.fit(of_coordinate) for of_coordinate in data), m, history_inputs)
        for regression in residual.regressions:
            check_regression(model, regression, data[0].points)
    return residual


def _history_inputs(data: Mapping[str, Any]) -> HistoryInputs:
    """The history inputs of a saved residual; JSON has no infinity, so an infinite forgetting time is null."""
    forgetting_time = inf if data.get("forgetting_time", 0) is None else number(data, "forgetting_time")
    context_inputs = integer(data, "context_inputs") if "context_inputs" in data else 0
    if not 0 <= context_inputs <= LARGEST_DIMENSION:
        raise ValueError(f"context_inputs must be from 0 to {LARGEST_DIMENSION}, not {context_inputs}")
    if data.get("lagged_inputs", "none") != "none":
        raise ValueError(
            f"lagged_inputs = {data['lagged_inputs']!r:.40}: models with inputs of the step before are gone, since "
            "beliefs know its error and command"
        )
    return HistoryInputs(forgetting_time, context_inputs)


def _regression(model: ResidualModel, saved: object, where: str) -> Regression:
    """Restores a regression; `where` names its place in the file, for messages."""
    if not isinstance(saved, Mapping):
        raise ValueError(f"{where} must be a regression, not {saved!r:.40}")
    points = saved.get("points")
    if isinstance(points, list) and any(isinstance(point, list) and len(point) > LARGEST_DIMENSION for point in points):
        raise ValueError(f"{where}.points must have at most {LARGEST_DIMENSION} columns")
    try:
        return model.from_dict(saved)
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from error
    except Exception as error:
        raise failed(model, error) from error
