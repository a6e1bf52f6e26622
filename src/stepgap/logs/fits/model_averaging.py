"""Model averaging: the prediction of all residuals together, each with the weight that held-out steps give it.

The weights maximise the density of the held-out errors under the mixture of the predictions (stacking of predictive
distributions: Yao, Vehtari, Simpson, Gelman, Using stacking to average Bayesian predictive distributions, 2018). So
nothing is selected, and one more log changes a prediction a little instead of exchanging it for another one.

Each state coordinate has its own weights. The steps of a block are predicted with weights that were computed without
them; otherwise the averaged prediction would seem better than it is.
"""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from stepgap.base.normal import INTERVAL_95, log_density
from stepgap.learning.settings import AUTO
from stepgap.logs.fits.validation import HeldOut, Validation
from stepgap.step import Array

ROUNDS = 300
"""Rounds of expectation maximisation; the density of the errors has converged to a millionth of a nat long before."""


def stacking_weights(log_densities: Array) -> Array:
    """Weights of K predictions that maximise Σ log Σₖ wₖ pₖ, by expectation maximisation.

    Args:
        log_densities: Logarithms of the densities pₖ of N held-out values; shape (N, K).

    Returns:
        Not negative, with the sum one; shape (K,).
    """
    densities = np.exp(log_densities - log_densities.max(axis=1, keepdims=True))
    weights = np.full(densities.shape[1], 1 / densities.shape[1])
    for _ in range(ROUNDS):
        shares = densities * weights
        weights = np.mean(shares / shares.sum(axis=1, keepdims=True), axis=0)
    return weights


def common_weights(validation: Validation) -> dict[str, float]:
    """Weight of each residual if it must be the same in all state coordinates, from all held-out steps."""
    members = _members(validation)
    weights = stacking_weights(_log_densities(list(members.values())).sum(axis=0))
    return dict(zip(members, weights.tolist(), strict=True))


def residual_weights(validation: Validation) -> dict[str, Array]:
    """Weight of each residual in the state coordinates, from all held-out steps; shapes (n,)."""
    members = _members(validation)
    weights = np.stack([stacking_weights(each) for each in _log_densities(list(members.values()))], axis=-1)
    return dict(zip(members, weights, strict=True))


@lru_cache(maxsize=1)  # asked for again by every sentence on the same validation
def averaged(validation: Validation) -> HeldOut:
    """The averaged prediction of the held-out steps; its standard deviation is that of the mixture."""
    held_out, block = list(_members(validation).values()), validation.folds.block
    log_densities = _log_densities(held_out)
    weights = np.empty_like(log_densities)
    for number in np.unique(block):
        inside = block == number
        others = log_densities[:, ~inside] if (~inside).any() else log_densities
        weights[:, inside] = np.stack([stacking_weights(each) for each in others])[:, None]
    means, stds = (np.stack([getattr(each, name) for each in held_out], axis=1) for name in ("mean", "std"))
    mean = np.einsum("nrk,rkn->rn", weights, means)
    square = np.einsum("nrk,rkn->rn", weights, means**2 + stds**2)
    seconds = sum(each.seconds for each in held_out)
    return replace(held_out[0], kind="average", mean=mean, std=np.sqrt(square - mean**2), seconds=seconds)


def correlation_of_successive(held_out: HeldOut, follows: NDArray[np.bool_]) -> tuple[Array, float]:
    """Correlation of the remaining errors of successive steps, and half its 95 % interval without any correlation.

    Args:
        held_out: Predictions.
        follows: Whether each step is the one after the step in the row above; shape (N,).
    """
    error, after = held_out.remaining, np.flatnonzero(follows)
    if len(after) < 3:
        return np.zeros(error.shape[1]), np.inf
    now, before = (error[rows] - error[rows].mean(axis=0) for rows in (after, after - 1))
    power = np.sqrt((now**2).sum(axis=0) * (before**2).sum(axis=0))
    correlation = np.divide((now * before).sum(axis=0), power, out=np.zeros(error.shape[1]), where=power > 0)
    return correlation, INTERVAL_95 / np.sqrt(len(after))


def _members(validation: Validation) -> dict[str, HeldOut]:
    """Predictions that are averaged: all but `auto`, which is always equal to another one."""
    return {kind: each for kind, each in validation.held_out.items() if kind != AUTO}


def _log_densities(held_out: Sequence[HeldOut]) -> Array:
    """Log density of each held-out step's error in each coordinate under each residual; shape (n, N, K)."""
    return np.stack([log_density(each.remaining, each.std).T for each in held_out], axis=-1)
