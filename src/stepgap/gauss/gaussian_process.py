"""Gaussian process regression of one output with explicit basis functions: a constant and, optionally, slopes.

The model is value = β + slopes · point + f(point) + noise:

- β, the constant, has a flat prior, as in the paper's `fitrgp` call (Sec. 6).
- Each slope, per `input_scale`, has the prior N(0, slope_std²); slope_std = 0 gives the model of the paper.
- f has zero mean and the covariance signal_std² k(r), where k is a stationary `Kernel` and r the distance of two
  points, each input divided by `input_scale · length_scale`.
- The noise is independent, with the standard deviation noise_std.

All parts are estimated jointly. Variances and covariances in this module are divided by signal_std²; their unit is
written [signal²]. Equations marked RW are those of Rasmussen and Williams, Gaussian Processes for Machine Learning
(2006).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import number, numbers
from stepgap.base.ranges import require
from stepgap.gauss.covariance import Covariance
from stepgap.gauss.kernel import Kernel
from stepgap.step import Array


@final
@dataclass(frozen=True, eq=False)
class HyperParameters:
    """Hyper-parameters; `gaussian_process_fit` estimates them.

    Attributes:
        length_scale: Distance over which f changes, in units of `input_scale`; shape (d,).
        signal_std: Standard deviation of f [unit of the values].
        noise_std: Standard deviation of the noise of one value [unit of the values].
        slope_std: Prior standard deviation of each slope [unit of the values per input scale].
    """

    length_scale: Array
    signal_std: float
    noise_std: float
    slope_std: float = 0.0

    def __post_init__(self) -> None:
        require(_positive(self.length_scale), "length_scale", self.length_scale, "be positive and finite")
        require(_positive(self.signal_std), "signal_std", self.signal_std, "be positive and finite")
        for name in ("noise_std", "slope_std"):
            std = getattr(self, name)
            require(std == 0 or _positive(std), name, std, "be non-negative and finite")

    @property
    def noise_variance(self) -> float:
        """Variance of the noise of one value [signal²]."""
        return (self.noise_std / self.signal_std) ** 2

    def covariance(self, kernel: Kernel, centres: Array, input_scale: Array) -> Covariance:
        """Covariance of queries and fixed centres (M, d).

        The linear features are zero at the first centre; as β is free, any other point would give the same model.
        """
        slope_scale = self.slope_std / self.signal_std / input_scale
        return Covariance(kernel, centres, centres[0], input_scale * self.length_scale, slope_scale)

    def std(self, variance: Array, include_noise: bool) -> Array:
        """Standard deviation [unit of the values] of a variance [signal²], without or with the noise."""
        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.signal_std * np.sqrt(np.maximum(variance, 0))
        return np.hypot(std, self.noise_std) if include_noise else std

    def std_gradient(self, half_variance_gradient: Array, std: Array) -> Array:
        """∂std/∂point = ½ ∂variance/∂point / std, given ½ ∂variance/∂point [signal²] (…, d) and `std` (…)."""
        half = self.signal_std**2 * half_variance_gradient
        return np.divide(half, std[..., None], out=np.zeros_like(half), where=std[..., None] != 0)


class LeftOut(NamedTuple):
    """Predictions of values from others, with the same hyper-parameters; shapes (N,) [unit of the values].

    Attributes:
        mean: Expected values.
        std: Standard deviations as `GaussianProcess.std(…, include_noise=True)`, with the β of the others.
        kriging_std: Standard deviations as `GaussianProcess.kriging_std(…, include_noise=True)`.
    """

    mean: Array
    std: Array
    kriging_std: Array


@dataclass(frozen=True, eq=False)
class GaussianProcess(ABC):
    """A Gaussian process conditioned on data.

    Immutable: `append` returns a new one. Query points have shape (…, d) and the units of `points`; where one is not
    finite, the result is NaN.

    Attributes:
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        input_scale: Fixed scale of each input, the unit of its length scale; shape (d,).
        hyper_parameters: Length scales, signal, noise and slopes.
        kernel: Covariance of f.
    """

    points: Array
    values: Array
    input_scale: Array
    hyper_parameters: HyperParameters
    kernel: Kernel

    @property
    @abstractmethod
    def coefficient(self) -> float:
        """β, the constant of the mean; without slopes, the prediction far from all data [unit of the values]."""

    @abstractmethod
    def append(self, point: ArrayLike, value: float) -> "GaussianProcess":
        """The process conditioned on one more point (d,) and value, with the same hyper-parameters."""

    @abstractmethod
    def leave_one_out(self) -> LeftOut:
        """Predicts each value from all others, from which β is estimated, too."""

    @abstractmethod
    def leave_out(self, blocks: Sequence[slice]) -> LeftOut:
        """Predicts each value from the values outside its block, as `leave_one_out` does for single values.

        Args:
            blocks: Consecutive parts of the values. A block with all values leaves no data for the prediction.
        """

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values] (RW Eq. 2.38)."""
        covariance, (weights, slopes) = self.covariance, self.weights

        def mean_of_block(query: Array) -> Array:
            return (
                self.coefficient
                + covariance.cross_covariance(query) @ weights
                + covariance.linear_features(query) @ slopes
            )

        return covariance.blockwise(mean_of_block, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance, (weights, slopes) = self.covariance, self.weights
        slope = slopes * covariance.slope_scale
        return covariance.blockwise(lambda query: covariance.cross_covariance_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation with β taken as known (RW Eq. 2.26); shape (…) [unit of the values].

        With slopes, β is the value at the first centre, and the standard deviation depends on this choice.

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value, as MATLAB's `predict` returns.
        """
        return self.hyper_parameters.std(self.covariance.blockwise(self._variance, point), include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation with the uncertainty of the estimated β (universal kriging, RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value.
        """
        return self.hyper_parameters.std(self.covariance.blockwise(self._kriging_variance, point), include_noise)

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point without noise; shape (…, d) [unit of the values per unit of each input].

        At points without uncertainty the standard deviation has a kink; zero is returned there.
        """
        half = self.covariance.blockwise(self._half_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.std(point))

    def kriging_std_gradient(self, point: ArrayLike) -> Array:
        """∂kriging_std/∂point without noise, as `std_gradient`; shape (…, d)."""
        half = self.covariance.blockwise(self._half_kriging_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.kriging_std(point))

    def to_dict(self) -> dict[str, Any]:
        """Kernel, data and hyper-parameters for JSON, which define the process."""
        return {
            "kernel": self.kernel.name,
            "input_scale": self.input_scale.tolist(),
            "points": self.points.tolist(),
            "values": self.values.tolist(),
            "length_scale": self.hyper_parameters.length_scale.tolist(),
            "signal_std": self.hyper_parameters.signal_std,
            "noise_std": self.hyper_parameters.noise_std,
            "slope_std": self.hyper_parameters.slope_std,
        }

    @property
    def _centres(self) -> Array:
        """Points at which f has weights in the prediction: all data here, fewer in a sparse process; shape (M, d)."""
        return self.points

    @cached_property
    def covariance(self) -> Covariance:
        """Covariance of queries and the centres."""
        return self.hyper_parameters.covariance(self.kernel, self._centres, self.input_scale)

    @cached_property
    def weights(self) -> tuple[Array, Array]:
        """Weights in the mean: of the covariances with the centres (M,) and of the linear features (d,)."""
        return self._solve_weights()

    @abstractmethod
    def _solve_weights(self) -> tuple[Array, Array]:
        """Weights in the mean: of the covariances with the centres (M,) and of the linear features (d,).

        Their unit is that of the values.
        """

    @abstractmethod
    def _variance(self, query: Array) -> Array:
        """Variance with β taken as known [signal²]; shape (Q,)."""

    @abstractmethod
    def _kriging_variance(self, query: Array) -> Array:
        """Variance that includes the uncertainty of β [signal²]; shape (Q,)."""

    @abstractmethod
    def _half_variance_gradient(self, query: Array) -> Array:
        """½ ∂_variance/∂query [signal²]; shape (Q, d)."""

    @abstractmethod
    def _half_kriging_variance_gradient(self, query: Array) -> Array:
        """½ ∂_kriging_variance/∂query [signal²]; shape (Q, d)."""


def checked_data(points: ArrayLike, values: ArrayLike, input_scale: ArrayLike) -> tuple[Array, Array, Array]:
    """Copies of the data; raises ValueError, which names the argument, if a shape or a number is wrong."""
    points, values, input_scale = np.array(points, float), np.array(values, float), np.array(input_scale, float)
    require(input_scale.ndim == 1 and input_scale.size > 0, "input_scale.shape", input_scale.shape, "be (d,)")
    require(_positive(input_scale), "input_scale", input_scale, "be positive and finite")
    sized = points.ndim == 2 and len(points) > 0 and points.shape[1] == len(input_scale)
    require(sized, "points.shape", points.shape, f"be (N, {len(input_scale)}) with N ≥ 1")
    require(np.isfinite(points).all(), "points", points, "be finite")
    require(values.shape == points.shape[:1], "values.shape", values.shape, f"be ({len(points)},)")
    require(np.isfinite(values).all(), "values", values, "be finite")
    return points, values, input_scale


def check_sizes(hyper_parameters: HyperParameters, input_scale: Array) -> None:
    """Raises ValueError unless there is one length scale for each input."""
    shape = hyper_parameters.length_scale.shape
    require(shape == input_scale.shape, "length_scale.shape", shape, f"be that of input_scale, {input_scale.shape}")


def check_kernel(data: Mapping[str, Any], kernel: Kernel) -> None:
    """Raises ValueError if the data name another kernel; those of former versions name none."""
    name = data.get("kernel", kernel.name)
    require(name == kernel.name, "kernel", name, f"be {kernel.name!r}")


def saved_data(data: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Points, values and input scales of a saved process; raises ValueError, which names the wrong key."""
    return numbers(data, "points", 2), numbers(data, "values", 1), numbers(data, "input_scale", 1)


def saved_hyper_parameters(data: Mapping[str, Any]) -> HyperParameters:
    """Hyper-parameters of a saved process; raises ValueError, which names the wrong key."""
    length_scale = numbers(data, "length_scale", 1)
    return HyperParameters(length_scale, *(number(data, name) for name in ("signal_std", "noise_std", "slope_std")))


def _positive(array: ArrayLike) -> bool:
    return bool(np.all(np.isfinite(array) & (np.asarray(array) > 0)))
