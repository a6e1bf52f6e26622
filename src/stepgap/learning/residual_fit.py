"""Fits residuals to observations: with a given model, or with the one of the best held-out predictions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from stepgap.base.json_data import integer, number, numbers
from stepgap.base.normal import log_density
from stepgap.learning.diagnosis import diagnose
from stepgap.learning.disturbance import LEAST_EVIDENCE, without_periodic_part
from stepgap.learning.entry_points import load_residual_model, residual_models
from stepgap.learning.observations import Observations
from stepgap.learning.outliers import LEAST_KNOWN, MOST_OUTLIERS, outliers_among
from stepgap.learning.prior import Prior
from stepgap.learning.prior_evidence import applies, most_probable
from stepgap.learning.regression import Regression, ResidualModel
from stepgap.learning.residual import HistoryInputs, Residual, no_residual
from stepgap.learning.residual_check import check_regression, failed, naming_model
from stepgap.learning.settings import AUTO, LAGGED_INPUTS, LaggedInputs, LearningSettings
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


def learned_residual(
    observations: Observations,
    settings: LearningSettings,
    iteration: int,
    start: Residual | None = None,
    priors: Sequence[Prior] = (),
) -> Residual:
    """Fits the residual of the settings as a deployment does.

    If the settings want it, outliers are left out, and so is the periodic part of the errors.

    Args:
        observations: Observations to learn from; if there are none, the residual is zero.
        settings: Which residual model is used, and what is left out.
        iteration: Number of the deployment that is running, from whose errors nothing is removed.
        start: A residual fitted to fewer observations, from which a search for hyper-parameters may start.
        priors: Priors over robots, of which the most probable is used where it applies and predicts better.

    Raises:
        InputError: There is no model of this name, or it cannot be used; even if there are no observations.
        ResidualError: The model failed, or what it returned is not valid.
    """
    residual = _learned_residual(observations, settings, iteration, start, priors)
    if not settings.reject_outliers:
        return residual
    kept, without_outliers = np.arange(len(observations)), residual
    while len(kept) >= LEAST_KNOWN and without_outliers.kind != "none":
        outliers = _outliers_of(without_outliers, observations.selected(kept))
        if not outliers.any():
            break
        kept = kept[~outliers]
        if len(kept) < (1 - MOST_OUTLIERS) * len(observations):
            return residual
        without_outliers = _learned_residual(observations.selected(kept), settings, iteration, without_outliers, priors)
    left_out = np.delete(observations.labels, kept, axis=0)
    return replace(without_outliers, outliers=tuple((int(deployment), int(number)) for deployment, number in left_out))


def _learned_residual(
    observations: Observations,
    settings: LearningSettings,
    iteration: int,
    start: Residual | None,
    priors: Sequence[Prior],
) -> Residual:
    """Fits to all observations, which may include outliers: the residual of the settings, or that with the prior."""
    residual = _residual_of_settings(observations, settings, iteration, start)
    if not priors or settings.residual == NONE.name:
        return residual
    used = observations
    if settings.remove_yaw_dependence and len(observations):
        used = without_periodic_part(observations, iteration)
    expected = most_probable(priors, used)
    if not applies(expected, used):
        return residual
    if residual.kind == NONE.name:
        return expected
    gain = len(used) * (held_out_score(residual, used) - held_out_score(expected, used))
    return residual if gain > LEAST_EVIDENCE else expected


def _residual_of_settings(
    observations: Observations, settings: LearningSettings, iteration: int, start: Residual | None
) -> Residual:
    """Fits the residual of the settings to all observations, which may include outliers."""
    model = AUTO if settings.residual == AUTO else load_residual_model(settings.residual)
    if not len(observations):
        model = NONE  # that of the settings was loaded nevertheless: if it cannot be, no robot moves
    if settings.remove_yaw_dependence and model != NONE:
        cleaned = without_periodic_part(observations, iteration)
        residual = fit_residual(model, cleaned, settings.lagged_inputs, settings.forgetting_time, start)
        if residual.kind != NONE.name:
            return residual
        model = NONE  # without a correction no disturbance is estimated: it counts as noise
    return fit_residual(model, observations, settings.lagged_inputs, settings.forgetting_time, start)


def _outliers_of(residual: Residual, observations: Observations) -> NDArray[np.bool_]:
    """Which of the steps that a residual was fitted to are outliers, each predicted from the others; shape (N,)."""
    labels, scale = observations.labels, observations.space.state_scale
    each = [slice(row, row + 1) for row in range(len(labels))]
    predictions = [regression.left_out(each) for regression in residual.regressions]
    error = [one.values - predicted.mean for one, predicted in zip(residual.regressions, predictions, strict=True)]
    same, next_one = np.diff(labels, axis=0, prepend=labels[:1]).T
    std = np.stack([predicted.std for predicted in predictions], axis=1)
    space, follows = observations.space, (same == 0) & (next_one == 1)
    points = space.scaled_inputs(observations.state, observations.command)
    return outliers_among(np.stack(error, axis=1) / scale, std / scale, follows, points)


def explains_better(residual: Residual, other: Residual, observations: Observations) -> bool:
    """Whether a residual that was fitted to the latest deployment alone predicts it better than one fitted to all.

    Each of its steps is predicted from those outside its part of the deployment.

    Args:
        residual: Fitted to the latest deployment.
        other: Fitted to all observations.
        observations: All of them.
    """
    latest = observations.selected(observations.labels[:, 0] == observations.labels[-1, 0])
    own, of_all = _held_out_densities(residual, latest), _held_out_densities(other, observations)
    gains = np.array([own[label] - of_all[label] for label in own.keys() & of_all.keys()])
    return bool(gains.sum() > LEAST_EVIDENCE + 2 * np.sqrt(np.sum(gains**2)))


def _held_out_densities(residual: Residual, observations: Observations) -> dict[tuple[int, int], float]:
    """Log density of each step of the latest deployment, predicted from those outside its part of it, by its label.

    The residual was fitted to all observations but its outliers.
    """
    labels = [(int(deployment), int(number)) for deployment, number in observations.labels]
    kept = [label for label in labels if label not in residual.outliers]
    rows = np.flatnonzero([label[0] == labels[-1][0] for label in kept])
    blocks = [slice(part[0], part[-1] + 1) for part in np.array_split(rows, SELECTION_FOLDS) if len(part)]
    before, total = rows[0], np.zeros(len(rows))
    for regression in residual.regressions:
        mean, std = regression.left_out([slice(0, before), *blocks] if before else blocks)
        total += log_density(regression.values[rows] - mean[rows], std[rows])
    return dict(zip(kept[before:], total.tolist(), strict=True))


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
    labels = numbers(data, "outliers", 2) if data.get("outliers") else np.empty((0, 2))
    if labels.shape[1] != 2:
        raise ValueError("outliers must be pairs of the numbers of a deployment and a step")
    outliers = tuple((int(deployment), int(step)) for deployment, step in labels)
    return Residual(model, regressions, command_size, history_inputs, outliers=outliers)


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
