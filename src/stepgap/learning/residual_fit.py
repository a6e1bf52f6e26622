"""Fits residuals to observations: with a given model, or with the one of the best held-out predictions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any, Literal

import numpy as np

from stepgap.base.json_data import integer, number
from stepgap.base.normal import log_density
from stepgap.learning.diagnosis import diagnose
from stepgap.learning.entry_points import load_residual_model, residual_models
from stepgap.learning.observations import Observations
from stepgap.learning.regression import Regression, ResidualModel
from stepgap.learning.residual import HistoryInputs, Residual, no_residual
from stepgap.learning.residual_check import check_regression, failed, naming_model
from stepgap.learning.settings import AUTO, LAGGED_INPUTS, LaggedInputs
from stepgap.learning.zero import NONE

SELECTION_FOLDS = 5
"""Number of contiguous parts of the record, each predicted from the others, by which `auto` chooses."""

LARGEST_DIMENSION = 100
"""Largest number of state coordinates, of command coordinates, and of inputs of a regression that is read."""


def fit_residual(
    residual: str | ResidualModel,
    observations: Observations,
    lagged_inputs: LaggedInputs | Literal["auto"] = "none",
    forgetting_time: float = inf,
    start: Residual | None = None,
) -> Residual:
    """Fits a model of the nominal map's error (Eq. 12).

    `auto` selects by the best `held_out_score`: first the model among all installed candidates, the simplest of equally
    good ones; then the lagged inputs of that model, if the `diagnosis` finds that the step before helps.

    Args:
        residual: Name of an installed model, `auto`, or a model itself.
        observations: Observations to learn from.
        lagged_inputs: Inputs from the step before; those that the model always has are added.
        forgetting_time: As in `HistoryInputs` [steps].
        start: A residual fitted to fewer observations, from which a search for hyper-parameters may start.

    Raises:
        InputError: There is no model of this name, or it cannot be used.
        ResidualError: The model failed, or what it returned is not valid.
        ValueError: There is nothing to learn from.
    """
    space = observations.space
    if isinstance(residual, ResidualModel):
        models = [residual]
    else:
        models = _candidates(observations) if residual == AUTO else [load_residual_model(residual)]
    if not len(observations):
        if residual == AUTO or models == [NONE]:
            return no_residual(len(space.state), len(space.command))
        raise ValueError(f"residual {models[0].name!r} needs at least one step")

    least: LaggedInputs = "none" if lagged_inputs == "auto" else lagged_inputs
    fits = [
        _fit(model, _history_inputs(model, least, forgetting_time, observations), observations, start)
        for model in models
    ]
    found = _best(fits, observations)
    if lagged_inputs == "auto" and diagnose(observations).lagged:
        wider = LAGGED_INPUTS[LAGGED_INPUTS.index(found.history_inputs.lagged_inputs) + 1 :]
        inputs = [replace(found.history_inputs, lagged_inputs=each) for each in wider]
        more = [_fit(found.model, each, observations, start) for each in inputs]
        found = _best([found, *more], observations)
    return found


def held_out_score(residual: Residual, observations: Observations) -> float:
    """Score of a residual in cross-validation: each error is predicted from those outside its part of the record.

    The parts are contiguous because neighbouring steps are alike: a flexible model would predict a single held-out step
    well from its neighbours. The steps of the next deployment have no such neighbours, nor has the middle of a part.

    Args:
        residual: Residual fitted to the observations.
        observations: The N observations; with fewer than `SELECTION_FOLDS` each is a part.

    Returns:
        Mean log predictive density of an error, summed over the coordinates; −inf where a prediction is missing.
    """
    parts = np.array_split(np.arange(len(observations)), min(SELECTION_FOLDS, len(observations)))
    blocks, score = [slice(part[0], part[-1] + 1) for part in parts], 0.0
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
    regressions = tuple(_regression(model, item, f"regressions[{i}]") for i, item in enumerate(saved))
    forgetting_time = inf if data.get("forgetting_time", 0) is None else number(data, "forgetting_time")
    context_inputs = integer(data, "context_inputs") if "context_inputs" in data else 0
    if not 0 <= context_inputs <= LARGEST_DIMENSION:
        raise ValueError(f"context_inputs must be from 0 to {LARGEST_DIMENSION}, not {context_inputs}")
    history_inputs = HistoryInputs(data.get("lagged_inputs"), forgetting_time, context_inputs)  # pyright: ignore[reportArgumentType] it checks them
    return Residual(model, regressions, command_size, history_inputs)


def names_without_lagged_inputs() -> tuple[str, ...]:
    """Names of the installed residuals without lagged inputs, from simple to complex; then `auto`."""
    return (*(model.name for model in residual_models() if model.lagged_inputs == "none"), AUTO)


def _candidates(observations: Observations) -> list[ResidualModel]:
    """Models among which `auto` chooses, from simple to complex: those whose inputs are known."""
    known = LAGGED_INPUTS[:1] if observations.history is None else LAGGED_INPUTS
    return [model for model in residual_models() if model.candidate and model.lagged_inputs in known]


def _history_inputs(
    model: ResidualModel, lagged_inputs: LaggedInputs, forgetting_time: float, observations: Observations
) -> HistoryInputs:
    """The requested inputs and those that the model always has; each of `LAGGED_INPUTS` includes the one before it."""
    widest = max(LAGGED_INPUTS.index(lagged_inputs), LAGGED_INPUTS.index(model.lagged_inputs))
    return HistoryInputs(LAGGED_INPUTS[widest], forgetting_time, observations.context_inputs)


def _best(fits: Sequence[Residual], observations: Observations) -> Residual:
    """The residual with the best held-out score; the first of equally good ones."""
    if len(fits) == 1:
        return fits[0]
    return max(fits, key=lambda residual: held_out_score(residual, observations))


def _fit(
    model: ResidualModel, history_inputs: HistoryInputs, observations: Observations, start: Residual | None
) -> Residual:
    """Fits a residual of one model; what it returns is checked."""
    if start is None or start.kind != model.name or start.history_inputs != history_inputs:
        starts: Sequence[Regression | None] = [None] * len(observations.space.state)
    else:
        starts = start.regressions
    data = [observations.training_data(history_inputs, coordinate) for coordinate in range(len(starts))]
    with naming_model(model):
        regressions = tuple(model.fit(*arguments) for arguments in zip(data, starts, strict=True))
        residual = Residual(model, regressions, len(observations.space.command), history_inputs)
        for regression in regressions:
            check_regression(model, regression, data[0].points)
    return residual


def _regression(model: ResidualModel, saved: object, where: str) -> Regression:
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
