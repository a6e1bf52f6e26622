"""The Gaussian processes as regressions of a residual's coordinate."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, final

from numpy.typing import ArrayLike

from stepgap.learning.gaussian_process import GaussianProcess, append, leave_out
from stepgap.learning.regression import Prediction, Regression
from stepgap.learning.sparse_gaussian_process import Process, process_from_dict
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
    process: Process

    @property
    def inputs(self) -> int:
        """As the process has them."""
        return self.process.points.shape[1]

    @property
    def noise_std(self) -> float:
        """As the process has it."""
        return self.process.hyper_parameters.noise_std

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
        if self.kind == "fitrgp" and isinstance(self.process, GaussianProcess):
            return self.process.std_gradient(point, include_noise=include_noise)
        return self.process.kriging_std_gradient(point, include_noise=include_noise)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Each value as predicted, with noise, from those outside its block (RW Eq. 5.12, block by block)."""
        return Prediction(*leave_out(self.process, blocks))

    def append(self, point: ArrayLike, value: float) -> "GaussianProcessRegression":
        """The same process, conditioned on one more value, in O(N²); in O(M³) if sparse."""
        return GaussianProcessRegression(self.kind, append(self.process, point, value))

    def to_dict(self) -> dict[str, Any]:
        """Data and hyper-parameters."""
        return {"kind": self.kind, **self.process.to_dict()}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> "GaussianProcessRegression":
        """The regression that `to_dict` saved; ValueError names what is wrong in it."""
        return GaussianProcessRegression(data["kind"], process_from_dict(data))
