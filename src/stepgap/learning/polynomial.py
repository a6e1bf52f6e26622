"""Polynomials of the scaled inputs, fitted by Bayesian linear regression: constant, linear, quadratic.

value = φ(point)ᵀ w + noise, where φ holds the monomials up to the degree. The conjugate prior (`LinearPosterior`) is
weak: weights, in units of the value per half range of the inputs, are some `PRIOR_STD` standard deviations of the
noise, and the prior of the noise's variance counts like `PRIOR_COUNT` values of standard deviation `NOISE_SCALE`. So
one value is enough, and inputs that do not vary, or vary together, do no harm: weights that the data do not determine
remain uncertain, and so do predictions with them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.gauss.linear_regression import LinearPosterior
from stepgap.gauss.monomials import monomials, monomials_gradient, number_of_monomials
from stepgap.learning.regression import BatchRegression, Parameter, Prediction, ResidualModel, TrainingData
from stepgap.step import Array

PRIOR_STD = 30.0  # Prior standard deviation of a weight, in standard deviations of the noise

PRIOR_COUNT = 3.0
"""Number of values that the prior of the noise is worth; with fewer, Student's t has no standard deviation."""

NOISE_SCALE = 0.02  # Prior standard deviation of the noise of a step's error, in half ranges of the state


@final
@dataclass(frozen=True, eq=False)
class Polynomial(BatchRegression):
    """A polynomial conditioned on data.

    Standard deviations are those of Student's t distribution, which are larger for fewer values.

    The time, which is the last input of timed data, is in no monomial. Instead older values count less, by a factor of
    1/e for each unit of time.

    Attributes:
        degree: 0, 1 or 2.
    """

    degree: int

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one, for known weights."""
        return math.sqrt(self._posterior[2])

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self._basis(point) @ self.weights

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return np.einsum("...bd,b->...d", self._basis_gradient(point), self.weights)

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation; shape (…)."""
        basis = self._basis(point)
        return np.sqrt(np.einsum("...a,ab,...b->...", basis, self.weight_covariance, basis))

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""
        half = np.einsum("...ad,ab,...b->...d", self._basis_gradient(point), self.weight_covariance, self._basis(point))
        std = self.std(point)[..., None]
        return np.divide(half, std, out=np.zeros_like(half), where=std != 0)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions, with noise, of each value from those outside its block."""
        basis = self._basis(self.points)
        counts = self._counts
        mean = np.empty(len(self.values))
        std = np.empty(len(self.values))
        for block in blocks:
            others = self._known.learned(basis[block], self.values[block], -counts[block])
            weights, spread, noise_variance = others.solve(basis[block])
            mean[block] = basis[block] @ weights
            std[block] = np.sqrt(noise_variance * (1 + np.einsum("ka,ak->k", basis[block], spread)))
        return Prediction(mean, std)

    def to_dict(self) -> dict[str, Any]:
        """Converts the data to JSON-ready numbers; the rest follows."""
        return self.data.to_dict()

    def parameters(self) -> list[Parameter]:
        """Noise, and the value and slopes in the middle of the range of use."""
        slopes = [Parameter("slope in the middle", self.mean_gradient(self.data.centre), "value per input")]
        middle = Parameter("in the middle", float(self.mean(self.data.centre)), "value")
        return [*super().parameters(), middle, *(slopes if self.degree else [])]

    @cached_property
    def _known(self) -> LinearPosterior:
        """What prior and data say of weights and noise."""
        size = number_of_monomials(len(self.data.scale) - self.data.timed, self.degree)
        squares = PRIOR_COUNT * (NOISE_SCALE * self.data.value_scale) ** 2
        prior = LinearPosterior(np.eye(size) / PRIOR_STD**2, np.zeros(size), squares, PRIOR_COUNT)
        return prior.learned(self._basis(self.points), self.values, self._counts)

    @cached_property
    def _posterior(self) -> tuple[Array, Array, float]:
        """Weights (d_φ,), their covariance (d_φ, d_φ), and the noise's variance."""
        weights, inverse, noise_variance = self._known.solve(np.eye(len(self._known.projection)))
        return weights, noise_variance * inverse, noise_variance

    @property
    def weights(self) -> Array:
        """Expected weights of the monomials; shape (d_φ,)."""
        return self._posterior[0]

    @property
    def weight_covariance(self) -> Array:
        """Covariance of the weights; shape (d_φ, d_φ)."""
        return self._posterior[1]

    @property
    def _counts(self) -> Array:
        """Weight of each value; shape (N,)."""
        points = self.points
        return np.exp(points[:, -1] - points[-1:, -1]) if self.data.timed else np.ones(len(points))

    def _scaled(self, point: ArrayLike) -> Array:
        """Scaled inputs of the monomials; (…, d) to (…, d) or, if timed, (…, d − 1)."""
        scaled = self.data.scaled(point)
        return scaled[..., :-1] if self.data.timed else scaled

    def _basis(self, point: ArrayLike) -> Array:
        return monomials(self._scaled(point), self.degree) * _one_or_nan(point)

    def _basis_gradient(self, point: ArrayLike) -> Array:
        gradient = monomials_gradient(self._scaled(point), self.degree)
        time = np.zeros((*gradient.shape[:-1], int(self.data.timed)))
        return np.concatenate([gradient, time], axis=-1) / self.data.scale * _one_or_nan(point)[..., None]


def _one_or_nan(point: ArrayLike) -> Array:
    """1 for each point that is finite, otherwise NaN; (…, d) to (…, 1)."""
    return np.where(np.isfinite(point).all(axis=-1, keepdims=True), 1.0, np.nan)


def _from_dict(saved: Mapping[str, Any], degree: int) -> Polynomial:
    return Polynomial(TrainingData.from_dict(saved), degree)


def _model(name: str, degree: int, description: str) -> ResidualModel:
    fit = partial(Polynomial, degree=degree)
    from_dict = partial(_from_dict, degree=degree)
    description = f"{description}, fitted by Bayesian linear regression"
    return ResidualModel(name, description, fit, from_dict, candidate=True, complexity=degree + 1)


CONSTANT: Final = _model("constant", 0, "a constant")  # The residual `constant`
LINEAR: Final = _model("linear", 1, "a linear function")  # The residual `linear`
QUADRATIC: Final = _model("quadratic", 2, "a quadratic polynomial")  # The residual `quadratic`
