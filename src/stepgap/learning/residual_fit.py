"""Residuals from observations: of a given kind, or of the kind that predicts best what it has not seen."""

import math
from collections.abc import Mapping
from math import inf
from typing import Any, Literal

import numpy as np

from stepgap.learning.gaussian_process_fit import fit_like_fitrgp
from stepgap.learning.gaussian_process_regression import GAUSSIAN_PROCESSES, GaussianProcessRegression
from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import DEGREES, NOISE_SCALE, PRIOR_COUNT, Polynomial, fit_polynomial
from stepgap.learning.regression import Regression, Zero
from stepgap.learning.residual import Hindsight, Residual, no_residual
from stepgap.learning.saved import numbers, whole
from stepgap.learning.settings import FEATURES, KINDS, Features, ResidualKind
from stepgap.learning.sparse_gaussian_process import fit_process

CANDIDATES = ("none", "constant", "linear", "quadratic", "gp", "gp_on_linear")
"""Among which `auto` chooses: all but the one that is there for comparison only. Of equals the first wins."""

FOLDS = 5
"""Contiguous parts of the record, each predicted from the others, by which `auto` chooses."""

TIME_SCALE = 1e3
"""Memories after which a slope may matter to a Gaussian process: drift is followed, not extrapolated."""


def fit_residual(
    kind: ResidualKind,
    observations: Observations,
    features: Features | Literal["auto"] = "none",
    memory: float = inf,
    start: Residual | None = None,
) -> Residual:
    """Fit a model of the nominal map's error (Eq. 12).

    `auto` takes what predicts best by `held_out_score`: first the kind, then the features for that kind.

    Args:
        kind: Which model.
        observations: What to learn from.
        features: What of the step before is an input.
        memory: After how many steps what was learnt counts much less; inf: it counts for ever.
        start: A residual fitted to fewer observations, from which the search for hyper-parameters goes on.

    Raises:
        ValueError: An unknown kind, or nothing to learn from.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown residual {kind!r}; use one of {', '.join(KINDS)}")
    space = observations.space
    if not len(observations) and kind in ("none", "auto"):
        return no_residual(len(space.state), len(space.command))
    if not len(observations):
        raise ValueError(f"residual {kind!r} needs at least one step")

    hindsight = Hindsight("none" if features == "auto" else features, memory)
    kinds = CANDIDATES if kind == "auto" else (kind,)
    found = _best([_fit(each, hindsight, observations, start) for each in kinds], observations)
    if features == "auto":
        more = [_fit(found.kind, Hindsight(each, memory), observations, start) for each in FEATURES[1:]]
        found = _best([found, *more], observations)
    return found


def held_out_score(residual: Residual, observations: Observations, folds: int = FOLDS) -> float:
    """How well the errors are predicted, each from those outside its contiguous part of the record.

    Neighbouring steps are alike. So a step left out alone is as good as known to a flexible model that follows its
    neighbours; the steps of the next deployment have none, nor has the middle of a part left out.

    Args:
        residual: Fitted to the observations.
        observations: N steps.
        folds: How many parts; at most N.

    Returns:
        Mean log density of an error, summed over the coordinates; −inf where something is not predicted.
    """
    parts = np.array_split(np.arange(len(observations)), min(folds, len(observations)))
    blocks, score = [slice(part[0], part[-1] + 1) for part in parts], 0.0
    for regression, error in zip(residual.regressions, observations.error.T, strict=True):
        mean, std = regression.left_out(blocks)
        score += float(np.mean(-0.5 * ((error - mean) / std) ** 2 - np.log(std) - 0.5 * math.log(2 * math.pi)))
    return score if math.isfinite(score) else -math.inf


def residual_from_dict(data: Mapping[str, Any]) -> Residual:
    """The residual that `to_dict` saved.

    Raises:
        ValueError: A key is missing or holds something else than it should; the message names it.
    """
    saved = data.get("regressions")
    if not isinstance(saved, list) or not saved:
        raise ValueError("regressions must be a list of one regression per state coordinate")
    regressions = tuple(_regression(item, f"regressions[{i}]") for i, item in enumerate(saved))
    memory = inf if data.get("memory", 0) is None else float(numbers(data, "memory", 0))
    hindsight = Hindsight(data.get("features"), memory)  # pyright: ignore[reportArgumentType] it checks them
    return Residual(regressions, whole(data, "command_size"), hindsight)


def _best(fits: list[Residual], observations: Observations) -> Residual:
    if len(fits) == 1:
        return fits[0]
    return max(fits, key=lambda residual: held_out_score(residual, observations))


def _fit(kind: str, hindsight: Hindsight, observations: Observations, start: Residual | None) -> Residual:
    """A residual of one kind."""
    if start is None or start.kind != kind or start.hindsight != hindsight:
        before = [None] * len(observations.space.state)
    else:
        before = start.regressions
    fits = [_fit_coordinate(kind, hindsight, observations, i, former) for i, former in enumerate(before)]
    return Residual(tuple(fits), len(observations.space.command), hindsight)


def _fit_coordinate(
    kind: str, hindsight: Hindsight, observations: Observations, coordinate: int, start: Regression | None
) -> Regression:
    space, points = observations.space, observations.points(hindsight)
    values, value_scale = observations.error[:, coordinate], float(space.state_scale[coordinate])
    past = points.shape[1] - len(space.state) - len(space.command)
    scale = np.concatenate([space.state_scale, space.command_scale, np.ones(past)])
    noise_scale = NOISE_SCALE * value_scale
    if kind == "none":
        squares, freedom = PRIOR_COUNT * noise_scale**2 + float(values @ values), PRIOR_COUNT + len(values)
        return Zero(points.shape[1], math.sqrt(squares / (freedom - 2)))
    if kind in DEGREES:
        centre = np.concatenate([space.state_centre, space.command_centre, np.zeros(past)])
        return fit_polynomial(kind, points, values, centre, scale, noise_scale, timed=hindsight.timed)
    if kind == "fitrgp":
        return GaussianProcessRegression(kind, fit_like_fitrgp(points, values))
    if hindsight.timed:
        scale[-1] = TIME_SCALE
    process = fit_process(
        points,
        values,
        scale,
        value_scale,
        basis="linear" if kind == "gp_on_linear" else "constant",
        start=start.process.hyper_parameters if isinstance(start, GaussianProcessRegression) else None,
        last_length_scale=1 / TIME_SCALE if hindsight.timed else None,
    )
    return GaussianProcessRegression(kind, process)


def _regression(saved: object, where: str) -> Regression:
    if not isinstance(saved, Mapping):
        raise ValueError(f"{where} must be a regression, not {saved!r:.40}")
    kind = str(saved.get("kind"))
    try:
        if kind == "none":
            return Zero(whole(saved, "inputs"), float(numbers(saved, "noise_std", 0)))
        if kind in DEGREES:
            return Polynomial.from_dict(saved)
        if kind in GAUSSIAN_PROCESSES:
            return GaussianProcessRegression.from_dict(saved)
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from error
    raise ValueError(f"{where}.kind must be one of {', '.join(KINDS[:-1])}, not {kind!r:.40}")
