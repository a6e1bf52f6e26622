"""Polynomials of the scaled inputs, fitted by Bayesian linear regression: constant, linear, quadratic.

value = φ(point)ᵀ w + noise, where φ holds the monomials up to the degree. The conjugate prior (Gelman et
al., Bayesian Data Analysis, Secs. 3.3 and 14.8) is weak: weights, in units of the value per half range of the
inputs, are some `PRIOR_STD` standard deviations of the noise, and the variance of the noise is what `PRIOR_COUNT`
values of standard deviation `noise_scale` would tell. So one value is enough, and inputs that do not vary, or vary
together, do no harm: the weights they leave open stay open in the standard deviation.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from stepgap.learning.regression import Prediction, Regression
from stepgap.learning.saved import numbers, truth
from stepgap.step import Array

DEGREES = {"constant": 0, "linear": 1, "quadratic": 2}
"""Kinds of polynomial."""

PRIOR_STD = 30.0
"""A priori standard deviation of a weight, in standard deviations of the noise."""

PRIOR_COUNT = 3.0
"""How many values the prior of the noise counts for; with fewer Student's t would have no standard deviation."""

NOISE_SCALE = 0.02
"""A priori standard deviation of the noise of a step's error, in half ranges of the state."""


class Moments(NamedTuple):
    """Prior and data, added up; d_φ monomials.

    Attributes:
        information: 1 / PRIOR_STD² on the diagonal, + Σ φ φᵀ; shape (d_φ, d_φ).
        projection: Σ φ value; shape (d_φ,).
        squares: PRIOR_COUNT noise_scale² + Σ value².
        freedom: PRIOR_COUNT + N, degrees of freedom of the noise.
    """

    information: Array
    projection: Array
    squares: float
    freedom: float

    def plus(self, basis: Array, values: Array, counts: Array) -> "Moments":
        """With more values (k,) at monomials (k, d_φ), of which each counts so often (k,); negative: without them."""
        return Moments(
            self.information + (counts * basis.T) @ basis,
            self.projection + (counts * values) @ basis,
            self.squares + float((counts * values) @ values),
            self.freedom + float(counts.sum()),
        )

    def faded(self, prior: "Moments", share: float) -> "Moments":
        """With the data, but not the prior, counting less."""
        return Moments(
            prior.information + share * (self.information - prior.information),
            share * self.projection,
            prior.squares + share * (self.squares - prior.squares),
            prior.freedom + share * (self.freedom - prior.freedom),
        )

    def solve(self, basis: Array) -> tuple[Array, Array, float]:
        """Weights (d_φ,), information⁻¹ φᵀ for rows φ (k, d_φ), and the variance of a value's noise (Student's t)."""
        factor = cho_factor(self.information, lower=True)
        weights = cho_solve(factor, self.projection)
        noise_variance = (self.squares - float(self.projection @ weights)) / (self.freedom - 2)
        return weights, cho_solve(factor, basis.T), noise_variance


@final
@dataclass(frozen=True, eq=False)
class Polynomial(Regression):
    """A polynomial conditioned on data; made by `fit_polynomial`.

    Standard deviations are those of Student's t distribution, which are larger the fewer the values.

    Attributes:
        kind: Which degree, one of `DEGREES`.
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        centre: Where the scaled inputs are zero; shape (d,).
        scale: Size of each input; shape (d,).
        noise_scale: A priori standard deviation of the noise [unit of the values].
        timed: Whether the last input is a time, which never falls. It is in no monomial; instead values count less,
            the longer ago they were: 1/e for each unit of it.
        moments: Prior and data, added up.
    """

    kind: str
    points: Array
    values: Array
    centre: Array
    scale: Array
    noise_scale: float
    timed: bool
    moments: Moments

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return len(self.scale)

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one, if the weights were known."""
        return math.sqrt(self._noise_variance)

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self._basis(point) @ self._weights

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return np.einsum("...bd,b->...d", self._basis_gradient(point), self._weights)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation; shape (…)."""
        basis = self._basis(point)
        spread = np.einsum("...a,ab,...b->...", basis, self._covariance, basis)
        return np.sqrt(spread + (self._noise_variance if include_noise else 0.0))

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d)."""
        half = np.einsum("...ad,ab,...b->...d", self._basis_gradient(point), self._covariance, self._basis(point))
        std = self.std(point, include_noise=include_noise)[..., None]
        return np.divide(half, std, out=np.zeros_like(half), where=std != 0)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Each value as predicted, with noise, from those outside its block, with the same prior."""
        basis, counts = self._basis(self.points), self._counts
        mean, std = np.empty(len(self.values)), np.empty(len(self.values))
        for block in blocks:
            others = self.moments.plus(basis[block], self.values[block], -counts[block])
            weights, spread, noise_variance = others.solve(basis[block])
            mean[block] = basis[block] @ weights
            std[block] = np.sqrt(noise_variance * (1 + np.einsum("ka,ak->k", basis[block], spread)))
        return Prediction(mean, std)

    def append(self, point: ArrayLike, value: float) -> "Polynomial":
        """The same prior, conditioned on one more value; costs as much as solving for the weights."""
        point = np.asarray(point, float)
        moments = self.moments
        if self.timed and len(self.points):
            moments = moments.faded(self._prior, float(np.exp(self.points[-1, -1] - point[-1])))
        return replace(
            self,
            points=np.vstack([self.points, point]),
            values=np.append(self.values, value),
            moments=moments.plus(self._basis(point)[None], np.array([value]), np.ones(1)),
        )

    def to_dict(self) -> dict[str, Any]:
        """Data and prior as JSON-ready numbers; everything else follows from them."""
        arrays = {name: getattr(self, name).tolist() for name in ("points", "values", "centre", "scale")}
        return {"kind": self.kind, **arrays, "noise_scale": self.noise_scale, "timed": self.timed}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Polynomial":
        """The polynomial that `to_dict` saved.

        Raises:
            ValueError: A key is missing, or holds anything but finite numbers of the right size and sign.
        """
        return fit_polynomial(
            data["kind"],
            numbers(data, "points", 2),
            numbers(data, "values", 1),
            numbers(data, "centre", 1),
            numbers(data, "scale", 1),
            float(numbers(data, "noise_scale", 0)),
            timed=truth(data, "timed"),
        )

    @cached_property
    def _posterior(self) -> tuple[Array, Array, float]:
        """Weights (d_φ,), their covariance (d_φ, d_φ), and the noise's variance."""
        weights, inverse, noise_variance = self.moments.solve(np.eye(len(self.moments.projection)))
        return weights, noise_variance * inverse, noise_variance

    @property
    def _weights(self) -> Array:
        return self._posterior[0]

    @property
    def _covariance(self) -> Array:
        return self._posterior[1]

    @property
    def _noise_variance(self) -> float:
        return self._posterior[2]

    @property
    def _prior(self) -> Moments:
        return _prior(self.kind, self.inputs - self.timed, self.noise_scale)

    @property
    def _counts(self) -> Array:
        """How much each value counts; shape (N,)."""
        return np.exp(self.points[:, -1] - self.points[-1:, -1]) if self.timed else np.ones(len(self.points))

    def _scaled(self, point: ArrayLike) -> Array:
        """The inputs that monomials are made of; (…, d) to (…, d) or, if timed, (…, d − 1)."""
        scaled = (np.asarray(point, float) - self.centre) / self.scale
        return scaled[..., :-1] if self.timed else scaled

    def _basis(self, point: ArrayLike) -> Array:
        return monomials(self._scaled(point), DEGREES[self.kind])

    def _basis_gradient(self, point: ArrayLike) -> Array:
        gradient = _monomials_gradient(self._scaled(point), DEGREES[self.kind])
        time = np.zeros((*gradient.shape[:-1], int(self.timed)))
        return np.concatenate([gradient, time], axis=-1) / self.scale


def fit_polynomial(
    kind: str,
    points: ArrayLike,
    values: ArrayLike,
    centre: ArrayLike,
    scale: ArrayLike,
    noise_scale: float,
    *,
    timed: bool = False,
) -> Polynomial:
    """Condition a polynomial on data.

    Args:
        kind: One of `DEGREES`.
        points: Shape (N, d); N may be zero.
        values: Shape (N,).
        centre: Where the scaled inputs are zero; shape (d,).
        scale: Fixed size of each input, not taken from the data; shape (d,).
        noise_scale: A priori standard deviation of the noise [unit of the values].
        timed: Whether the last input is a time; see `Polynomial`.

    Raises:
        ValueError: Shapes or numbers that do not fit; the message names which.
    """
    points, values = np.array(points, float), np.array(values, float)
    centre, scale = np.array(centre, float), np.array(scale, float)
    _check(points, values, centre, scale, noise_scale)
    empty = Polynomial(
        kind, points, values, centre, scale, noise_scale, timed, _prior(kind, len(scale) - timed, noise_scale)
    )
    return replace(empty, moments=empty.moments.plus(empty._basis(points), values, empty._counts))


def _prior(kind: str, inputs: int, noise_scale: float) -> Moments:
    """What is believed without data."""
    size = sum([1, inputs, inputs * (inputs + 1) // 2][: DEGREES[kind] + 1])
    return Moments(np.eye(size) / PRIOR_STD**2, np.zeros(size), PRIOR_COUNT * noise_scale**2, PRIOR_COUNT)


def _check(points: Array, values: Array, centre: Array, scale: Array, noise_scale: float) -> None:
    if scale.ndim != 1 or not (np.isfinite(scale) & (scale > 0)).all():
        raise ValueError("scale must be of shape (d,), positive and finite")
    if centre.shape != scale.shape or not np.isfinite(centre).all():
        raise ValueError(f"centre must be {len(scale)} finite numbers, as many as scale")
    if points.ndim != 2 or points.shape[1] != len(scale) or not np.isfinite(points).all():
        raise ValueError(f"points must be finite and of shape (N, {len(scale)}), not {points.shape}")
    if values.shape != points.shape[:1] or not np.isfinite(values).all():
        raise ValueError(f"values must be finite and of shape ({len(points)},), not {values.shape}")
    if not (np.isfinite(noise_scale) and noise_scale > 0):
        raise ValueError("noise_scale must be positive and finite")


def monomials(x: Array, degree: int) -> Array:
    """1, xᵢ, xᵢ xⱼ (i ≤ j) up to a degree; (…, d) to (…, d_φ)."""
    i, j = np.triu_indices(x.shape[-1])
    parts = [np.ones((*x.shape[:-1], 1)), x, x[..., i] * x[..., j]][: degree + 1]
    return np.concatenate(parts, axis=-1)


def _monomials_gradient(x: Array, degree: int) -> Array:
    """∂monomial/∂x; (…, d) to (…, d_φ, d)."""
    d = x.shape[-1]
    (i, j), unit = np.triu_indices(d), np.eye(d)
    bend = unit[i] * x[..., j, None] + unit[j] * x[..., i, None]
    parts = [np.zeros((*x.shape[:-1], 1, d)), np.broadcast_to(unit, (*x.shape[:-1], d, d)), bend][: degree + 1]
    return np.concatenate(parts, axis=-2)
