"""Gaussian process of one output: constant, slopes, stationary kernel, independent noise; one joint model.

The model: value = β + slopes · point + f(point) + noise. β has a flat prior, as in the paper's `fitrgp` call
(Sec. 6). A priori each slope, per `input_scale`, is N(0, slope_std²); with slope_std = 0 the model is that of
the paper. f has the covariance signal_std² k(r), where r is the distance of two points measured in
`input_scale · length_scale`, one length scale per input, and k a `Kernel`. Equations marked RW are those of Rasmussen
and Williams, Gaussian Processes for Machine Learning (2006).
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import number, numbers
from stepgap.learning.covariance import Covariance
from stepgap.learning.kernel import Kernel
from stepgap.step import Array


@final
@dataclass(frozen=True, eq=False)
class HyperParameters:
    """Hyper-parameters, which a fit chooses; see `gaussian_process_fit`.

    Attributes:
        length_scale: Distance over which f changes, in input scales; shape (d,).
        signal_std: Standard deviation of f [unit of the values].
        noise_std: Standard deviation of the noise of one value [unit of the values].
        slope_std: Prior standard deviation of each slope [unit of the values per input scale].
    """

    length_scale: Array
    signal_std: float
    noise_std: float
    slope_std: float = 0.0

    def __post_init__(self) -> None:
        ensure(_positive(self.length_scale), "length_scale", "positive and finite")
        ensure(_positive(self.signal_std), "signal_std", "positive and finite")
        for name in ("noise_std", "slope_std"):
            std = getattr(self, name)
            ensure(std == 0 or _positive(std), name, "non-negative and finite")

    def covariance(self, kernel: Kernel, centres: Array, input_scale: Array) -> Covariance:
        """Covariance with fixed centres (M, d); the linear features are zero at the first one, an arbitrary choice."""
        slope_scale = self.slope_std / self.signal_std / input_scale
        return Covariance(kernel, centres, centres[0], input_scale * self.length_scale, slope_scale)

    def std(self, variance: Array, include_noise: bool) -> Array:
        """Standard deviation that belongs to a variance [signal²], without or with the noise."""
        # Rounding can leave a variance slightly below zero at a point that was observed.
        std = self.signal_std * np.sqrt(np.maximum(variance, 0))
        return np.hypot(std, self.noise_std) if include_noise else std

    def std_gradient(self, half_variance_gradient: Array, std: Array) -> Array:
        """∂std/∂point, given ½ ∂variance/∂point [signal²] (…, d) and `std` (…)."""
        half = self.signal_std**2 * half_variance_gradient
        return np.divide(half, std[..., None], out=np.zeros_like(half), where=std[..., None] != 0)


@dataclass(frozen=True, eq=False)
class GaussianProcess(ABC):
    """A Gaussian process conditioned on data.

    Immutable: `append` returns a new one. Queries have shape (…, d) and the units of `points`; a query that is not
    finite gives NaN.

    Attributes:
        points: Inputs; shape (N, d).
        values: Outputs; shape (N,).
        input_scale: Fixed size of each input, in which its length scale is measured; shape (d,).
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
        """β: without slopes, the mean far from all data [unit of the values]."""

    @abstractmethod
    def append(self, point: ArrayLike, value: float) -> "GaussianProcess":
        """Conditions the process on one more point (d,) and value, at the same hyper-parameters."""

    @abstractmethod
    def leave_one_out(self) -> tuple[Array, Array]:
        """Leave-one-out predictions: each value predicted from all others, at the same hyper-parameters.

        Returns:
            Means and standard deviations of the noisy values, as those of `kriging_std(…, include_noise=True)`;
            shapes (N,) and (N,) [unit of the values].
        """

    @abstractmethod
    def leave_out(self, blocks: Sequence[slice]) -> tuple[Array, Array]:
        """Leave-block-out predictions: as `leave_one_out`, but each value is predicted from those outside its block.

        Args:
            blocks: Consecutive parts of the values; a block of all values leaves no data for its prediction.
        """

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…) [unit of the values] (RW Eq. 2.38)."""
        covariance, (weights, slopes) = self._covariance, self._weights

        def mean(query: Array) -> Array:
            return (
                self.coefficient
                + covariance.cross_covariance(query) @ weights
                + covariance.linear_features(query) @ slopes
            )

        return covariance.blockwise(mean, point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d) [unit of the values per unit of each input]."""
        covariance, (weights, slopes) = self._covariance, self._weights
        slope = slopes * covariance.slope_scale
        return covariance.blockwise(lambda query: covariance.cross_covariance_gradient(query, weights) + slope, point)

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Plug-in standard deviation, which treats β as exact (RW Eq. 2.26); shape (…) [unit of the values].

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value, as in MATLAB's `predict`.
        """
        return self.hyper_parameters.std(self._covariance.blockwise(self._variance, point), include_noise)

    def kriging_std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Universal-kriging standard deviation: as `std`, with an uncertain β (RW Eq. 2.42); shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of β + slopes · point + f. True: of a new noisy value.
        """
        return self.hyper_parameters.std(self._covariance.blockwise(self._kriging_variance, point), include_noise)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d) [unit of the values per unit of each input]; see `kriging_std_gradient`."""
        half = self._covariance.blockwise(self._half_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.std(point, include_noise=include_noise))

    def kriging_std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂kriging_std/∂point; shape (…, d) [unit of the values per unit of each input].

        Zero where the standard deviation is zero: it has a kink there, at points whose value is known exactly.

        Args:
            point: Shape (…, d).
            include_noise: As for `kriging_std`.
        """
        half = self._covariance.blockwise(self._half_kriging_variance_gradient, point)
        return self.hyper_parameters.std_gradient(half, self.kriging_std(point, include_noise=include_noise))

    def to_dict(self) -> dict[str, Any]:
        """Converts data and hyper-parameters to JSON-ready numbers; the rest, except the kernel, follows from them."""
        return {
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
        """Points whose covariances with a query give the prediction there; shape (M, d)."""
        return self.points

    @cached_property
    def _covariance(self) -> Covariance:
        """Covariance of queries and the centres."""
        return self.hyper_parameters.covariance(self.kernel, self._centres, self.input_scale)

    @cached_property
    def _weights(self) -> tuple[Array, Array]:
        return self._solve_weights()

    @abstractmethod
    def _solve_weights(self) -> tuple[Array, Array]:
        """Weights of the covariances with the centres (M,) and of the linear features (d,) [unit of the values]."""

    @abstractmethod
    def _variance(self, query: Array) -> Array:
        """Plug-in variance [signal²]; shape (Q,)."""

    @abstractmethod
    def _kriging_variance(self, query: Array) -> Array:
        """Variance of universal kriging [signal²]; shape (Q,)."""

    @abstractmethod
    def _half_variance_gradient(self, query: Array) -> Array:
        """½ ∂_variance/∂query [signal²]; shape (Q, d)."""

    @abstractmethod
    def _half_kriging_variance_gradient(self, query: Array) -> Array:
        """½ ∂_kriging_variance/∂query [signal²]; shape (Q, d)."""


def checked_data(points: ArrayLike, values: ArrayLike, input_scale: ArrayLike) -> tuple[Array, Array, Array]:
    """Checks shapes and values of the data and returns copies."""
    points, values, input_scale = np.array(points, float), np.array(values, float), np.array(input_scale, float)
    ensure(input_scale.ndim == 1 and input_scale.size > 0, "input_scale", "of shape (d,)")
    ensure(_positive(input_scale), "input_scale", "positive and finite")
    sized = points.ndim == 2 and len(points) > 0 and points.shape[1] == len(input_scale)
    ensure(sized, "points", f"of shape (N, {len(input_scale)}) with N ≥ 1, not {points.shape}")
    ensure(np.isfinite(points).all(), "points", "finite")
    ensure(values.shape == points.shape[:1], "values", f"of shape ({len(points)},), not {values.shape}")
    ensure(np.isfinite(values).all(), "values", "finite")
    return points, values, input_scale


def check_sizes(hyper_parameters: HyperParameters, input_scale: Array) -> None:
    """Raises ValueError unless there is one length scale for each input."""
    same = hyper_parameters.length_scale.shape == input_scale.shape
    ensure(same, "length_scale", f"as many numbers as input_scale ({len(input_scale)})")


def saved_data(data: Mapping[str, Any]) -> tuple[Array, Array, Array]:
    """Reads points, values and input scales of a saved process; a ValueError names the wrong key."""
    return numbers(data, "points", 2), numbers(data, "values", 1), numbers(data, "input_scale", 1)


def saved_hyper_parameters(data: Mapping[str, Any]) -> HyperParameters:
    """Reads the hyper-parameters of a saved process; a ValueError names the wrong key."""
    length_scale = numbers(data, "length_scale", 1)
    return HyperParameters(length_scale, *(number(data, name) for name in ("signal_std", "noise_std", "slope_std")))


def _positive(array: ArrayLike) -> bool:
    return bool(np.all(np.isfinite(array) & (np.asarray(array) > 0)))


def ensure(condition: object, name: str, rule: str) -> None:
    """Raises ValueError `NAME must be RULE` unless the condition holds."""
    if not condition:
        raise ValueError(f"{name} must be {rule}")
