"""The Gaussian processes as regressions of a residual's coordinate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, final

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from stepgap.learning.gaussian_process import GaussianProcess
from stepgap.learning.regression import DataRegression, Prediction
from stepgap.step import Array

GaussianProcessKind = Literal["gp", "gp_on_linear", "fitrgp"]
"""Ours with a constant or a linear basis, or the one that MATLAB's `fitrgp` would have given."""


@final
@dataclass(frozen=True, eq=False)
class GaussianProcessRegression(DataRegression):
    """A Gaussian process.

    Attributes:
        kind: `fitrgp` reports plug-in standard deviations, the others universal-kriging ones.
        process: The process.
    """

    kind: GaussianProcessKind
    process: GaussianProcess

    @property
    def inputs(self) -> int:
        """As the process has them."""
        return self.process.points.shape[1]

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self.process.mean(point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return self.process.mean_gradient(point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation; shape (…)."""
        std = self.process.std if self.kind == "fitrgp" else self.process.kriging_std
        return std(point, include_noise=include_noise)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d)."""
        raise NotImplementedError

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Each value as predicted, with noise, from those outside its block (RW Eqs. 5.10–5.12, by blocks).

        The basis is estimated anew without the block.
        """
        solved, values = self.process.least_squares, self.process.values
        whitened = solve_triangular(solved.factor, np.eye(len(values)), lower=True)
        basis, _ = np.linalg.qr(solved.basis.reshape(len(values), -1))
        whitened -= basis @ (basis.T @ whitened)
        precision, weights = whitened.T @ whitened, solved.weights
        means, variances = np.empty(len(values)), np.empty(len(values))
        for block in blocks:
            covariance = np.linalg.inv(precision[block, block])
            means[block] = values[block] - covariance @ weights[block]
            variances[block] = covariance.diagonal()
        return Prediction(means, self.process.hyper_parameters.signal_std * np.sqrt(variances))

    def append(self, point: ArrayLike, value: float) -> "GaussianProcessRegression":
        """The same process, conditioned on one more value."""
        raise NotImplementedError

    def to_dict(self) -> dict[str, Any]:
        """Data and hyper-parameters."""
        return {"kind": self.kind, **self.process.to_dict()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "GaussianProcessRegression":
        """The regression that `to_dict` saved; ValueError names what is wrong in it."""
        return GaussianProcessRegression(data["kind"], GaussianProcess.from_dict(data))
