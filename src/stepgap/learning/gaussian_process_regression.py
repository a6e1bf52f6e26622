"""The Gaussian processes as regressions of a residual's coordinate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.learning.gaussian_process import GaussianProcess, append
from stepgap.learning.regression import Prediction, Regression
from stepgap.step import Array

GAUSSIAN_PROCESSES = ("gp", "gp_on_linear", "fitrgp")
"""Kinds: ours with a constant or a linear basis, or the one that MATLAB's `fitrgp` would have given."""


@final
@dataclass(frozen=True, eq=False)
class GaussianProcessRegression(Regression):
    """A Gaussian process.

    Attributes:
        kind: `fitrgp` reports plug-in standard deviations, the others universal-kriging ones.
        process: The process.
    """

    kind: str
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
        gradient = self.process.std_gradient if self.kind == "fitrgp" else self.process.kriging_std_gradient
        return gradient(point, include_noise=include_noise)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Each value as predicted, with noise, from those outside its block (RW Eq. 5.12, block by block).

        β is estimated from those alone, too. Of nothing nothing is predicted: NaN.
        """
        solved, values = self.process.least_squares, self.process.values
        mean, variance = np.full(len(values), np.nan), np.full(len(values), np.nan)
        whitened = solved.factor.solve(np.eye(len(values)))
        basis = solved.basis / np.linalg.norm(solved.basis)
        whitened -= np.outer(basis, basis @ whitened)
        for block in blocks:
            if len(values[block]) < len(values):
                covariance = np.linalg.inv(whitened[:, block].T @ whitened[:, block])
                mean[block] = values[block] - covariance @ solved.weights[block]
                variance[block] = covariance.diagonal()
        return Prediction(mean, self.process.hyper_parameters.signal_std * np.sqrt(variance))

    def append(self, point: ArrayLike, value: float) -> "GaussianProcessRegression":
        """The same process, conditioned on one more value, in O(N²)."""
        return GaussianProcessRegression(self.kind, append(self.process, point, value))

    def to_dict(self) -> dict[str, Any]:
        """Data and hyper-parameters."""
        return {"kind": self.kind, **self.process.to_dict()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "GaussianProcessRegression":
        """The regression that `to_dict` saved; ValueError names what is wrong in it."""
        return GaussianProcessRegression(data["kind"], GaussianProcess.from_dict(data))
