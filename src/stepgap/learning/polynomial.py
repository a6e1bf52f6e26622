"""Polynomials of the scaled inputs, fitted by Bayesian linear regression: constant, linear, quadratic.

value = φ(point)ᵀ w + noise, where φ holds the monomials up to the degree. The conjugate prior (Gelman et
al., Bayesian Data Analysis, Secs. 3.3 and 14.8) is weak: weights, in units of the value per half range of the
inputs, are some `PRIOR_STD` standard deviations of the noise, and the prior of the noise's variance counts like
`PRIOR_COUNT` values of standard deviation `NOISE_SCALE`. So one value is enough, and inputs that do not vary, or vary
together, do no harm: weights that the data do not determine remain uncertain, and so do predictions with them.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Final, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from stepgap.base.json_data import as_object, number, numbers
from stepgap.base.ranges import require
from stepgap.gauss.monomials import monomials, monomials_gradient, number_of_monomials
from stepgap.learning.regression import BatchRegression, Parameter, Prediction, Regression, ResidualModel, TrainingData
from stepgap.step import Array

PRIOR_STD = 30.0
"""Prior standard deviation of a weight, in standard deviations of the noise."""

PRIOR_COUNT = 3.0
"""Number of values that the prior of the noise is worth; with fewer, Student's t has no standard deviation."""

NOISE_SCALE = 0.02
"""Prior standard deviation of the noise of a step's error, in half ranges of the state."""


class Moments(NamedTuple):
    """Sums over prior and data, for d_φ monomials.

    Attributes:
        information: 1 / PRIOR_STD² on the diagonal, + Σ φ φᵀ; shape (d_φ, d_φ).
        projection: Σ φ value; shape (d_φ,).
        squares: PRIOR_COUNT noise_scale² + Σ value².
        degrees_of_freedom: PRIOR_COUNT + N, those of the noise.
    """

    information: Array
    projection: Array
    squares: float
    degrees_of_freedom: float

    def plus(self, basis: Array, values: Array, counts: Array) -> "Moments":
        """Adds values (k,) at monomials (k, d_φ), each counted `counts` times (k,); negative counts remove values."""
        return Moments(
            self.information + (counts * basis.T) @ basis,
            self.projection + (counts * values) @ basis,
            self.squares + float((counts * values) @ values),
            self.degrees_of_freedom + float(counts.sum()),
        )

    def discounted(self, prior: "Moments", factor: float) -> "Moments":
        """Multiplies the weight of the data by a factor and keeps the prior."""
        return Moments(
            prior.information + factor * (self.information - prior.information),
            prior.projection + factor * (self.projection - prior.projection),
            prior.squares + factor * (self.squares - prior.squares),
            prior.degrees_of_freedom + factor * (self.degrees_of_freedom - prior.degrees_of_freedom),
        )

    def to_dict(self) -> dict[str, Any]:
        """Converts the sums to JSON-ready numbers, which `from_dict` reads."""
        return {name: np.asarray(value).tolist() for name, value in self._asdict().items()}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> "Moments":
        """Restores what `to_dict` saved; a ValueError names the wrong key."""
        found = Moments(
            numbers(saved, "information", 2),
            numbers(saved, "projection", 1),
            number(saved, "squares"),
            number(saved, "degrees_of_freedom"),
        )
        size = len(found.projection)
        require(found.information.shape == (size, size), "information.shape", found.information.shape, "be square")
        require(_is_positive(found.information), "information", found.information, "be positive definite")
        require(found.degrees_of_freedom > 2, "degrees_of_freedom", found.degrees_of_freedom, "be more than 2")
        least = float(found.projection @ np.linalg.solve(found.information, found.projection))
        require(found.squares > least, "squares", found.squares, f"be more than {least:g}")
        return found

    def solve(self, basis: Array) -> tuple[Array, Array, float]:
        """Weights (d_φ,), information⁻¹ φᵀ for rows φ (k, d_φ), and the variance of a value's noise (Student's t)."""
        factor = cho_factor(self.information, lower=True)
        weights = cho_solve(factor, self.projection)
        noise_variance = (self.squares - float(self.projection @ weights)) / (self.degrees_of_freedom - 2)
        return weights, cho_solve(factor, basis.T), noise_variance


def _is_positive(matrix: Array) -> bool:
    """Whether a matrix is symmetric and positive definite."""
    return np.array_equal(matrix, matrix.T) and bool((np.linalg.eigvalsh(matrix) > 0).all())


@final
@dataclass(frozen=True, eq=False)
class Polynomial(BatchRegression):
    """A polynomial conditioned on data; created by `fit_polynomial`.

    Standard deviations are those of Student's t distribution, which are larger for fewer values.

    The time, which is the last input of timed data, is in no monomial. Instead older values count less, by a factor of
    1/e for each unit of time.

    Attributes:
        degree: 0, 1 or 2.
        prior: Moments without data.
        moments: Sums over prior and data.
    """

    degree: int
    prior: Moments
    moments: Moments

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one, for known weights."""
        return math.sqrt(self._noise_variance)

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
        """Predictions, with noise, of each value from those outside its block, with the same prior."""
        basis, counts = self._basis(self.points), self._counts
        if len(blocks) == len(self.values):
            return self._left_one_out(basis, counts)
        mean, std = np.empty(len(self.values)), np.empty(len(self.values))
        for block in blocks:
            others = self.moments.plus(basis[block], self.values[block], -counts[block])
            weights, spread, noise_variance = others.solve(basis[block])
            mean[block] = basis[block] @ weights
            std[block] = np.sqrt(noise_variance * (1 + np.einsum("ka,ak->k", basis[block], spread)))
        return Prediction(mean, std)

    def _left_one_out(self, basis: Array, counts: Array) -> Prediction:
        """Predictions of each value from all others: those of `left_out`, by the leverage of each (Allen's PRESS)."""
        weights, spread, _ = self.moments.solve(basis)
        known, degrees = np.einsum("ka,ak->k", basis, spread), self.moments.degrees_of_freedom
        error, kept = self.values - basis @ weights, 1 - counts * known
        squares = self.moments.squares - float(self.moments.projection @ weights) - counts * error**2 / kept
        noise_variance = squares / (degrees - counts - 2)
        return Prediction(self.values - error / kept, np.sqrt(noise_variance * (1 + known / kept)))

    def append(self, point: ArrayLike, value: float) -> "Polynomial":
        """Conditions the polynomial on one more value; costs as much as solving for the weights."""
        point, moments = np.asarray(point, float), self.moments
        if self.data.timed and len(self.points):
            moments = moments.discounted(self.prior, float(np.exp(self.points[-1, -1] - point[-1])))
        moments = moments.plus(self._basis(point)[None], np.array([value]), np.ones(1))
        return replace(self, data=self.data.append(point, value), moments=moments)

    def to_dict(self) -> dict[str, Any]:
        """Converts the data to JSON-ready numbers, and the prior if it is not the weak one; the rest follows."""
        weak = weak_prior(self.data, self.degree)
        same = all(np.array_equal(one, other) for one, other in zip(self.prior, weak, strict=True))
        return {**self.data.to_dict(), **({} if same else {"prior": self.prior.to_dict()})}

    def parameters(self) -> list[Parameter]:
        """Noise, and the value and slopes in the middle of the range of use."""
        slopes = [Parameter("slope in the middle", self.mean_gradient(self.data.centre), "value per input")]
        middle = Parameter("in the middle", float(self.mean(self.data.centre)), "value")
        return [*super().parameters(), middle, *(slopes if self.degree else [])]

    @cached_property
    def _posterior(self) -> tuple[Array, Array, float]:
        """Weights (d_φ,), their covariance (d_φ, d_φ), and the noise's variance."""
        weights, inverse, noise_variance = self.moments.solve(np.eye(len(self.moments.projection)))
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
    def _noise_variance(self) -> float:
        return self._posterior[2]

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


def fit_polynomial(data: TrainingData, degree: int, prior: Moments | None = None) -> Polynomial:
    """Conditions a polynomial on data.

    Args:
        data: The data; N may be zero.
        degree: 0, 1 or 2.
        prior: Moments without data; None for those of the weak prior.
    """
    prior = prior or weak_prior(data, degree)
    empty = Polynomial(data, degree, prior, prior)
    return replace(empty, moments=prior.plus(empty._basis(data.points), data.values, empty._counts))


def weak_prior(data: TrainingData, degree: int) -> Moments:
    """Moments of the weak prior, without data."""
    inputs = len(data.scale) - data.timed
    size = number_of_monomials(inputs, degree)
    noise_scale = NOISE_SCALE * data.value_scale
    return Moments(np.eye(size) / PRIOR_STD**2, np.zeros(size), PRIOR_COUNT * noise_scale**2, PRIOR_COUNT)


def _one_or_nan(point: ArrayLike) -> Array:
    """1 for each point that is finite, otherwise NaN; (…, d) to (…, 1)."""
    return np.where(np.isfinite(point).all(axis=-1, keepdims=True), 1.0, np.nan)


def _fit(data: TrainingData, start: Regression | None, degree: int) -> Polynomial:
    return fit_polynomial(data, degree)


def _from_dict(saved: Mapping[str, Any], degree: int) -> Polynomial:
    data = TrainingData.from_dict(saved)
    if "prior" not in saved:
        return fit_polynomial(data, degree)
    prior, size = Moments.from_dict(as_object(saved["prior"], "prior")), len(weak_prior(data, degree).projection)
    require(len(prior.projection) == size, "prior.projection", prior.projection, f"have {size} numbers")
    return fit_polynomial(data, degree, prior)


def _model(name: str, degree: int, description: str) -> ResidualModel:
    """Creates the residual model of a degree."""
    fit, from_dict = partial(_fit, degree=degree), partial(_from_dict, degree=degree)
    description = f"{description}, fitted by Bayesian linear regression"
    return ResidualModel(name, description, fit, from_dict, candidate=True, complexity=degree + 1)


CONSTANT: Final = _model("constant", 0, "a constant")
"""The residual `constant`."""

LINEAR: Final = _model("linear", 1, "a linear function")
"""The residual `linear`."""

QUADRATIC: Final = _model("quadratic", 2, "a quadratic polynomial")
"""The residual `quadratic`."""
