"""Outliers: single steps that a push, a slip or a wrong measurement disturbed, of which nothing can be learned.

The error of a step is modelled by a mixture of two normal distributions with the mean of the prediction (Tukey, A
survey of sampling from contaminated distributions, 1960; Box and Tiao, A Bayesian approach to some outlier problems,
1968):

    p(error) = (1 − π) N(error | mean, std²) + π N(error | mean, κ² std²)

A step is *improbable* where the second component is the more likely origin of its error. An improbable step is an
outlier only if it is alone: errors that persist, or return at similar states and commands, are a change of the robot,
or a model that is wrong, and must be learned. So the classification step of a classification EM algorithm (Celeux and
Govaert, 1992) has these further conditions.

- `outliers_among` finds them in a record, from predictions of each step by the others. `residual_fit` fits again
  without them until it finds no more.
- `trust` judges a step when it has just been executed, by what was known before.
"""

from math import log, sqrt
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array

OUTLIER_PROBABILITY: Final = 0.02
"""π, the prior probability of an outlier."""

OUTLIER_WIDTH: Final = 10.0
"""κ, the standard deviation of an outlier's error, in predicted standard deviations."""

_LOG_ODDS = log((1 - OUTLIER_PROBABILITY) / OUTLIER_PROBABILITY) + log(OUTLIER_WIDTH)
IMPROBABLE: Final = sqrt(2 * _LOG_ODDS / (1 - OUTLIER_WIDTH**-2))
"""Error, in predicted standard deviations, from which on it is more likely that of an outlier: 3.6."""

LEAST_STD: Final = 0.02
"""A prediction is not taken to be more accurate than this [half ranges]: smaller errors do no harm, and a simulation
without noise would have outliers wherever a model is not exact."""

LEAST_KNOWN: Final = 20
"""With fewer steps the standard deviation of their errors is not known well enough for a judgement."""

SIMILAR: Final = 0.2
"""Steps are similar if their states and commands differ by less in every coordinate [half ranges]."""

MOST_OUTLIERS: Final = 0.2
"""If a larger part of the steps seemed to be outliers, the model is wrong, and no step is called an outlier."""


def improbable_errors(error: Array, std: Array) -> NDArray[np.int64]:
    """Sign of each error that is more likely that of an outlier, zero elsewhere; (…) and (…) to (…) [half ranges]."""
    return np.where(np.abs(error) > IMPROBABLE * np.maximum(std, LEAST_STD), np.sign(error), 0).astype(np.int64)


def outliers_among(error: Array, std: Array, follows: NDArray[np.bool_], points: Array) -> NDArray[np.bool_]:
    """Which steps are outliers.

    Args:
        error: Error of the prediction of each step from the others; shape (N, n) [half ranges].
        std: Standard deviation of this prediction, with noise; shape (N, n) [half ranges].
        follows: Whether each step is the one after the step in the row above; shape (N,).
        points: State and command of each step; shape (N, n + m) [half ranges].

    Returns:
        Shape (N,). An improbable error is none if its neighbour in time is improbable, too, in the same direction, or
        if that of more than half of all similar steps is.
    """
    signs = improbable_errors(error, std)
    same = ((signs[1:] == signs[:-1]) & (signs[1:] != 0)).any(axis=1) & follows[1:]
    persists = np.append(False, same) | np.append(same, False)
    for row in np.flatnonzero(signs.any(axis=1) & ~persists):
        similar = (np.abs(points - points[row]) < SIMILAR).all(axis=1)
        alike = (signs[similar] == signs[row])[:, signs[row] != 0].any(axis=1).sum()
        persists[row] = alike > max(1, similar.sum() / 2)
    return signs.any(axis=1) & ~persists
