"""The residual that is zero: it does not correct the nominal map."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import integer, number
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT
from stepgap.learning.regression import Prediction, Regression, ResidualModel, TrainingData
from stepgap.step import Array


@final
@dataclass(frozen=True)
class Zero(Regression):
    """A regression without correction: its mean and standard deviation are zero.

    Attributes:
        size: Number of inputs d.
        noise: Standard deviation of noisy values about zero; 0 if it is unknown.
    """

    size: int
    noise: float = 0.0

    @property
    def points(self) -> Array:
        """Inputs that it was fitted to, which are not kept; shape (0, d)."""
        return np.empty((0, self.size))

    @property
    def values(self) -> Array:
        """Values that it was fitted to, which are not kept; shape (0,)."""
        return np.empty(0)

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one."""
        return self.noise

    def mean(self, point: ArrayLike) -> Array:
        """Expected value, which is zero; shape (…)."""
        return np.where(np.isfinite(point).all(axis=-1), 0.0, np.nan)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point, which is zero; shape (…, d)."""
        return np.where(np.isfinite(point).all(axis=-1, keepdims=True), np.zeros(np.shape(point)), np.nan)

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation, which is zero; shape (…)."""
        return self.mean(point)

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point, which is zero; shape (…, d)."""
        return self.mean_gradient(point)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions of zero, with the noise of all values."""
        size = blocks[-1].stop
        return Prediction(np.zeros(size), np.full(size, self.noise))

    def append(self, point: ArrayLike, value: float) -> "Zero":  # noqa: ARG002
        """Returns itself; it keeps no data."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """Converts the number of inputs and the noise to JSON-ready numbers."""
        return {"inputs": self.size, "noise_std": self.noise}


def _fit(data: TrainingData) -> Zero:
    prior = PRIOR_COUNT * (NOISE_SCALE * data.value_scale) ** 2
    degrees_of_freedom = PRIOR_COUNT + len(data.values)
    squares = prior + float(data.values @ data.values)
    return Zero(data.points.shape[1], math.sqrt(squares / (degrees_of_freedom - 2)))


def _from_dict(saved: Mapping[str, Any]) -> Zero:
    noise_std = number(saved, "noise_std")
    if noise_std < 0:
        raise ValueError("noise_std must not be negative")
    return Zero(integer(saved, "inputs"), noise_std)


NONE: Final = ResidualModel("none", "nothing: the nominal map as it is", _fit, _from_dict, candidate=True, complexity=0)
"""The residual `none`."""
