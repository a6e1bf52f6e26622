"""Polynomials of the scaled inputs, fitted by Bayesian linear regression: constant, linear, quadratic.

value = φ(point)ᵀ w + noise, where φ holds the monomials up to the degree. The conjugate prior (Gelman et
al., Bayesian Data Analysis, Sec. 14.2 and 3.3) is weak: a weight, which is the change of the value over half
the range of an input, is `PRIOR_STD` standard deviations of the noise, and the variance of the noise is what
`PRIOR_COUNT` values of standard deviation `noise_scale` would tell. So one value is enough, and inputs that
do not vary, or vary together, do no harm: the weights they leave open stay open in the standard deviation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import cho_factor, cho_solve

from stepgap.learning.regression import DataRegression, Prediction
from stepgap.learning.saved import numbers
from stepgap.step import Array

DEGREES = {"none": -1, "constant": 0, "linear": 1, "quadratic": 2}
"""Kinds of polynomial; the first has no monomials at all."""

PRIOR_STD = 30.0
"""A priori standard deviation of a weight, in standard deviations of the noise."""

PRIOR_COUNT = 3.0
"""How many values the prior of the noise counts for; with fewer Student's t would have no standard deviation."""


class Moments(NamedTuple):
    """Prior and data, added up; d_φ monomials.

    Attributes:
        information: I / PRIOR_STD² + Σ φ φᵀ; shape (d_φ, d_φ).
        projection: Σ φ value; shape (d_φ,).
        squares: PRIOR_COUNT noise_scale² + Σ value².
        count: PRIOR_COUNT + N, the degrees of freedom of the noise.
    """

    information: Array
    projection: Array
    squares: float
    count: float

    def plus(self, basis: Array, values: Array, sign: float = 1.0) -> "Moments":
        """With more values (k,) at monomials (k, d_φ); with sign −1 without them."""
        return Moments(
            self.information + sign * basis.T @ basis,
            self.projection + sign * basis.T @ values,
            self.squares + sign * float(values @ values),
            self.count + sign * len(values),
        )

    def solve(self, basis: Array) -> tuple[Array, Array, float]:
        """Weights (d_φ,), information⁻¹ φᵀ for rows φ (k, d_φ), and the variance of Student's t for one value's noise."""
        factor = cho_factor(self.information, lower=True)
        weights = cho_solve(factor, self.projection)
        noise_variance = (self.squares - float(self.projection @ weights)) / (self.count - 2)
        return weights, cho_solve(factor, basis.T), noise_variance


@final
@dataclass(frozen=True, eq=False)
class Polynomial(DataRegression):
    """A polynomial conditioned on data; made by `fit_polynomial`.

    Standard deviations are those of Student's t distribution, which are larger the fewer the values.

    Attributes:
        kind: Which degree, one of `DEGREES`.
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        centre: Where the scaled inputs are zero; shape (d,).
        scale: Size of each input; shape (d,).
        noise_scale: A priori standard deviation of the noise [unit of the values].
        moments: Prior and data, added up.
    """

    kind: str
    points: Array
    values: Array
    centre: Array
    scale: Array
    noise_scale: float
    moments: Moments

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return len(self.scale)

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
        basis, means, stds = self._basis(self.points), np.empty(len(self.values)), np.empty(len(self.values))
        for block in blocks:
            others = self.moments.plus(basis[block], self.values[block], sign=-1.0)
            weights, spread, noise_variance = others.solve(basis[block])
            means[block] = basis[block] @ weights
            stds[block] = np.sqrt(noise_variance * (1 + np.einsum("ka,ak->k", basis[block], spread)))
        return Prediction(means, stds)

    def append(self, point: ArrayLike, value: float) -> "Polynomial":
        """The same prior, conditioned on one more value; costs what solving for the weights costs."""
        return replace(
            self,
            points=np.vstack([self.points, point]),
            values=np.append(self.values, value),
            moments=self.moments.plus(self._basis(point)[None], np.array([value])),
        )

    def to_dict(self) -> dict[str, Any]:
        """Data and prior as JSON-ready numbers; everything else follows from them."""
        arrays = {name: getattr(self, name).tolist() for name in ("points", "values", "centre", "scale")}
        return {"kind": self.kind, **arrays, "noise_scale": self.noise_scale}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "Polynomial":
        """The polynomial that `to_dict` saved.

        Raises:
            ValueError: A key is missing, or holds anything but finite numbers of the right size and sign.
        """
        centre, scale = numbers(data, "centre", 1), numbers(data, "scale", 1)
        noise_scale = float(numbers(data, "noise_scale", 0))
        return fit_polynomial(
            data["kind"], numbers(data, "points", 2), numbers(data, "values", 1), centre, scale, noise_scale
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

    def _basis(self, point: ArrayLike) -> Array:
        return _monomials((np.asarray(point, float) - self.centre) / self.scale, DEGREES[self.kind])

    def _basis_gradient(self, point: ArrayLike) -> Array:
        scaled = (np.asarray(point, float) - self.centre) / self.scale
        return _monomials_gradient(scaled, DEGREES[self.kind]) / self.scale


def fit_polynomial(
    kind: str, points: ArrayLike, values: ArrayLike, centre: ArrayLike, scale: ArrayLike, noise_scale: float
) -> Polynomial:
    """Condition a polynomial on data.

    Args:
        kind: One of `DEGREES`.
        points: Shape (N, d); N may be zero.
        values: Shape (N,).
        centre: Where the scaled inputs are zero; shape (d,).
        scale: Fixed size of each input, not taken from the data; shape (d,).
        noise_scale: A priori standard deviation of the noise [unit of the values].

    Raises:
        ValueError: Shapes or numbers that do not fit; the message names which.
    """
    points, values = np.array(points, float), np.array(values, float)
    centre, scale = np.array(centre, float), np.array(scale, float)
    _check(points, values, centre, scale, noise_scale)
    basis = _monomials((points - centre) / scale, DEGREES[kind])
    monomials = basis.shape[1]
    prior = Moments(np.eye(monomials) / PRIOR_STD**2, np.zeros(monomials), PRIOR_COUNT * noise_scale**2, PRIOR_COUNT)
    return Polynomial(kind, points, values, centre, scale, noise_scale, prior.plus(basis, values))


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


def _monomials(x: Array, degree: int) -> Array:
    """1, xᵢ, xᵢ xⱼ (i ≤ j) up to a degree; (…, d) to (…, d_φ)."""
    i, j = np.triu_indices(x.shape[-1])
    parts = [np.ones((*x.shape[:-1], 1)), x, x[..., i] * x[..., j]][: degree + 1]
    return np.concatenate([np.empty((*x.shape[:-1], 0)), *parts], axis=-1)


def _monomials_gradient(x: Array, degree: int) -> Array:
    """∂monomial/∂x; (…, d) to (…, d_φ, d)."""
    d = x.shape[-1]
    (i, j), unit = np.triu_indices(d), np.eye(d)
    bend = unit[i] * x[..., j, None] + unit[j] * x[..., i, None]
    parts = [np.zeros((*x.shape[:-1], 1, d)), np.broadcast_to(unit, (*x.shape[:-1], d, d)), bend][: degree + 1]
    return np.concatenate([np.empty((*x.shape[:-1], 0, d)), *parts], axis=-2)
