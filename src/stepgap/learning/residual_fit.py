"""Residuals from observations: of a given kind, or of the kind that predicts best what it has not seen."""

import math
from collections.abc import Mapping
from typing import Any, Literal, get_args

import numpy as np

from stepgap.learning.gaussian_process_fit import fit_gaussian_process, fit_like_fitrgp
from stepgap.learning.gaussian_process_regression import GaussianProcessKind, GaussianProcessRegression
from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import DEGREES, Polynomial, fit_polynomial
from stepgap.learning.regression import DataRegression, Regression, Zero
from stepgap.learning.residual import Residual, no_residual
from stepgap.learning.saved import numbers, whole
from stepgap.step import Array

FittedKind = Literal["none", "constant", "linear", "quadratic"] | GaussianProcessKind
"""Models of the nominal map's error."""

ResidualKind = FittedKind | Literal["auto"]
"""What `fit_residual` fits; `auto` is whichever predicts best."""

FITTED_KINDS: tuple[FittedKind, ...] = ("none", "constant", "linear", "quadratic", *get_args(GaussianProcessKind))
"""Names of the models."""

KINDS: tuple[ResidualKind, ...] = (*FITTED_KINDS, "auto")
"""What may be asked for."""

CANDIDATES: tuple[FittedKind, ...] = ("none", "constant", "linear", "quadratic", "gp", "gp_on_linear")
"""Among which `auto` chooses: all but the one that is there for comparison only. Of equals the first wins."""

FOLDS = 10
"""Contiguous parts of the record, each predicted from the others, by which `auto` chooses."""

NOISE_SCALE = 0.02
"""A priori standard deviation of a polynomial's noise, in half ranges of the state."""


def fit_residual(kind: ResidualKind, observations: Observations, start: Residual | None = None) -> Residual:
    """Fit a model of the nominal map's error (Eq. 12).

    Args:
        kind: Which model; `auto` chooses one for each state coordinate.
        observations: What to learn from.
        start: A residual fitted to fewer observations, from which the search for hyper-parameters goes on.

    Raises:
        ValueError: An unknown kind, or nothing to learn from.
    """
    if kind not in KINDS:
        raise ValueError(f"unknown residual {kind!r}; use one of {', '.join(KINDS)}")
    space = observations.space
    if not len(observations):
        if kind not in ("none", "auto"):
            raise ValueError(f"residual {kind!r} needs at least one step")
        return no_residual(len(space.state), len(space.command))
    before = start.regressions if start else (None,) * len(space.state)
    fitted = [_choose(observations, i, before[i]) if kind == "auto" else _fit(kind, observations, i, before[i]) for i in range(len(space.state))]
    return Residual(tuple(_settled(regression) for regression in fitted), len(space.command))


def held_out_score(regression: DataRegression, values: Array, folds: int = FOLDS) -> float:
    """Mean log density of values (N,), each as predicted from those outside its contiguous part of the record.

    Neighbouring steps are alike. So a value left out alone is as good as known to a flexible model that
    follows its neighbours; what comes after the record has none, nor has the middle of a part left out.
    At N values there are at most N folds, which leaves out each value alone.
    """
    parts = np.array_split(np.arange(len(values)), min(folds, len(values)))
    mean, std = regression.left_out([slice(part[0], part[-1] + 1) for part in parts])
    score = np.mean(-0.5 * ((values - mean) / std) ** 2 - np.log(std) - 0.5 * math.log(2 * math.pi))
    return float(score) if np.isfinite(score) else -math.inf


def residual_from_dict(data: Mapping[str, Any]) -> Residual:
    """The residual that `to_dict` saved.

    Raises:
        ValueError: A key is missing or holds something else than it should; the message names it.
    """
    saved = data.get("regressions")
    if not isinstance(saved, list) or not saved:
        raise ValueError("regressions must be a list of one regression per state coordinate")
    regressions = tuple(_regression(item, f"regressions[{i}]") for i, item in enumerate(saved))
    return Residual(regressions, whole(data, "command_size"))


def _choose(observations: Observations, coordinate: int, start: Regression | None) -> DataRegression:
    """The candidate with the best score."""
    candidates = [_fit(kind, observations, coordinate, start) for kind in CANDIDATES]
    return max(candidates, key=lambda regression: held_out_score(regression, observations.error[:, coordinate]))


def _fit(kind: FittedKind, observations: Observations, coordinate: int, start: Regression | None) -> DataRegression:
    points, values, scale = observations.points, observations.error[:, coordinate], observations.input_scale
    if kind in DEGREES:
        noise_scale = NOISE_SCALE * observations.space.state_scale[coordinate]
        return fit_polynomial(kind, points, values, observations.input_centre, scale, noise_scale)
    if kind == "fitrgp":
        return GaussianProcessRegression(kind, fit_like_fitrgp(points, values))
    return GaussianProcessRegression(kind, fit_gaussian_process(points, values, scale))


def _settled(regression: DataRegression) -> Regression:
    """A polynomial without monomials is no model."""
    if regression.kind != "none":
        return regression
    return Zero(regression.inputs, float(regression.std(np.zeros(regression.inputs), include_noise=True)))


def _regression(saved: object, where: str) -> Regression:
    if not isinstance(saved, Mapping):
        raise ValueError(f"{where} must be a regression, not {saved!r:.40}")
    kind = saved.get("kind")
    try:
        if kind == "none":
            return Zero(whole(saved, "inputs"), float(numbers(saved, "noise_std", 0)))
        if kind in DEGREES:
            return Polynomial.from_dict(saved)
        if kind in get_args(GaussianProcessKind):
            return GaussianProcessRegression.from_dict(saved)
    except ValueError as error:
        raise ValueError(f"{where}.{error}") from error
    raise ValueError(f"{where}.kind must be one of {', '.join(FITTED_KINDS)}, not {kind!r:.40}")
