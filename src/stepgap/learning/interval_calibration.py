"""Calibration of the 95 % intervals during a deployment, by the steps that were predicted before they were made.

A residual states how uncertain its predictions are, but it knows only the steps that it was fitted to: it has one noise
level for all of them, and few may resemble those of the next deployment. So its standard deviation σ is multiplied by a
factor that depends on the step:

    σ' = σ exp(w · φ)

φ consists of a constant, the state before the step and the predicted state after it (x and x² of each coordinate), and
the part of σ² that is not noise. After each step, with the error u in units of σ', the weights w move by a Newton step

    s = u² − 1 + QUANTILE_WEIGHT (1[|u| > 1.96] − 0.05)

along φ. Its first part is the derivative of the log likelihood, by which factors are found quickly (score-driven
models: Creal, Koopman and Lucas, 2013). The other one is that of the quantile loss, with which 5 % of the errors are
outside their interval even if they are not normal (Gibbs and Candès, Adaptive conformal inference under distribution
shift, 2021). Older steps count less, and a normal prior keeps w near zero, where it begins. Every error was predicted
from earlier steps only (Dawid, The prequential approach, 1984), so no step is set aside. Plans do not depend on this.
"""

from dataclasses import dataclass, replace
from math import exp, log
from typing import Final, Self, final

import numpy as np

from stepgap.base.normal import INTERVAL_95, log_density
from stepgap.step import Array, StepSpace

WEIGHT_STD: Final = 0.15  # Standard deviation of each weight a priori
MEMORY: Final = 500.0  # Number of steps in which the influence of a step falls to 1/e
QUANTILE_WEIGHT: Final = 5.0  # Weight of the quantile loss in a step

LARGEST_RATIO: Final = 3.0
"""In the likelihood, |u| counts as no larger: a push says nothing about the usual errors."""

LARGEST_FACTOR: Final = 20.0  # Bound of the factor, and of its reciprocal

FARTHEST_STATE: Final = 1.5
"""States farther from the middle count as at this distance [half ranges]: beyond, factors are not extrapolated."""

_MISSED: Final = 0.05
_DECAY: Final = exp(-1 / MEMORY)
_CURVATURE: Final = 2 + QUANTILE_WEIGHT * 2 * INTERVAL_95 * exp(log_density(np.array(INTERVAL_95), np.array(1.0)))
"""Expected derivative of −s by the logarithm of a factor, for normal errors."""


@final
@dataclass(frozen=True, eq=False)
class IntervalCalibration:
    """Factors on the standard deviations of predicted steps; immutable.

    Attributes:
        space: Names and scales of the states.
        weights: w of each state coordinate; shape (n, k) with k = 2 + 4n.
        information: Expected curvature in w of what the steps so far say; shape (n, k, k).
    """

    space: StepSpace
    weights: Array
    information: Array

    @classmethod
    def start(cls, space: StepSpace) -> Self:
        """Returns the calibration before the first step, whose factors are 1."""
        n = len(space.state)
        k = 2 + 4 * n
        return cls(space, np.zeros((n, k)), np.zeros((n, k, k)))

    def factor(self, state: Array, predicted: Array, share: Array) -> Array:
        """Factor on the standard deviation of a step's prediction; shape (n,).

        Args:
            state: State before the step; shape (n,).
            predicted: Predicted state after it; shape (n,). What is not finite counts as in the middle of its range.
            share: Part of each variance that is not noise, from 0 to 1; shape (n,).
        """
        exponent = np.sum(self.weights * self._features(state, predicted, share), axis=-1)
        return np.exp(np.clip(exponent, -log(LARGEST_FACTOR), log(LARGEST_FACTOR)))

    def after(self, state: Array, predicted: Array, share: Array, ratio: Array) -> Self:
        """Returns the calibration after a step.

        Args:
            state: As for `factor`.
            predicted: As for `factor`.
            share: As for `factor`.
            ratio: u, the error of the prediction in calibrated standard deviations; shape (n,). A coordinate that is
                not finite says nothing.
        """
        features = self._features(state, predicted, share) * np.isfinite(ratio)[:, None]
        size = np.abs(np.nan_to_num(ratio))
        precision = WEIGHT_STD**-2
        likelihood = np.minimum(size, LARGEST_RATIO) ** 2 - 1
        score = likelihood + QUANTILE_WEIGHT * ((size > INTERVAL_95) - _MISSED)
        information = _DECAY * self.information + _CURVATURE * features[:, :, None] * features[:, None, :]
        gradient = score[:, None] * features - (1 - _DECAY) * precision * self.weights
        step = np.linalg.solve(information + precision * np.eye(features.shape[1]), gradient[..., None])[..., 0]
        return replace(self, weights=self.weights + step, information=information)

    def _features(self, state: Array, predicted: Array, share: Array) -> Array:
        """φ for each state coordinate; shape (n, k)."""
        scaled = self.space.scaled_state(np.stack([state, predicted])).ravel()
        near = np.clip(np.nan_to_num(scaled), -FARTHEST_STATE, FARTHEST_STATE)
        common = np.concatenate([[1.0], near, near**2 - 1 / 3])  # x² has the mean 1/3 over the range of use
        return np.column_stack([np.tile(common, (len(share), 1)), share])
