"""Residual models that are Gaussian processes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, final

from numpy.typing import ArrayLike

from stepgap.gauss.gaussian_process import GaussianProcess, process_from_dict
from stepgap.gauss.gaussian_process_fit import Basis, fit_gaussian_process, fit_like_fitrgp
from stepgap.gauss.kernel import MATERN_52, Kernel
from stepgap.learning.regression import Parameter, Prediction, Regression, ResidualModel, TrainingData
from stepgap.step import Array

TIME_SCALE = 1e3
"""Input scale of the time, in forgetting times: so large that drift is tracked by f and not extrapolated by slopes."""


@final
@dataclass(frozen=True, eq=False)
class GaussianProcessRegression(Regression):
    """A Gaussian process as a regression.

    Attributes:
        process: The process.
        plug_in: Whether standard deviations treat the constant as exact, as in `fitrgp`, or are those of universal
            kriging.
    """

    process: GaussianProcess
    plug_in: bool = False

    @property
    def points(self) -> Array:
        """Inputs that it was fitted to; shape (N, d)."""
        return self.process.points

    @property
    def values(self) -> Array:
        """Values that it was fitted to; shape (N,)."""
        return self.process.values

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one."""
        return self.process.hyper_parameters.noise_std

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self.process.mean(point)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return self.process.mean_gradient(point)

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation; shape (…)."""
        return self.process.std(point) if self.plug_in else self.process.kriging_std(point)

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""
        return self.process.std_gradient(point) if self.plug_in else self.process.kriging_std_gradient(point)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions, with noise, of each value from those outside its block (RW Eq. 5.12 for blocks)."""
        predictions = self.process.leave_out(blocks)
        return Prediction(predictions.mean, predictions.std if self.plug_in else predictions.kriging_std)

    def append(self, point: ArrayLike, value: float) -> "GaussianProcessRegression":
        """Conditions the process on one more value."""
        return replace(self, process=self.process.append(point, value))

    def to_dict(self) -> dict[str, Any]:
        """Converts data and hyper-parameters to JSON-ready numbers."""
        return self.process.to_dict()

    def parameters(self) -> list[Parameter]:
        """Hyper-parameters and the constant."""
        fitted = self.process.hyper_parameters
        meaning = (
            "A length scale is the distance over which the error changes: one much longer than the range of the data "
            "means that this input hardly matters."
        )
        return [
            Parameter("length scale", fitted.length_scale * self.process.input_scale, "input", meaning),
            *super().parameters(),
            Parameter("signal", fitted.signal_std, "value"),
            Parameter("constant", self.process.coefficient, "value"),
        ]


def gaussian_process_model(
    name: str,
    description: str,
    basis: Basis,
    kernel: Kernel = MATERN_52,
    *,
    candidate: bool = False,
    complexity: int = 10,
) -> ResidualModel:
    """Creates a residual model that is a Gaussian process with this basis and kernel; see `ResidualModel`."""

    def fit(data: TrainingData) -> Regression:
        scale = data.scale.copy()
        if data.timed:
            scale[-1] = TIME_SCALE
        process = fit_gaussian_process(
            data.points,
            data.values,
            scale,
            data.value_scale,
            basis=basis,
            kernel=kernel,
            last_length_scale=1 / TIME_SCALE if data.timed else None,
        )
        return GaussianProcessRegression(process)

    def from_dict(saved: Mapping[str, Any]) -> Regression:
        return GaussianProcessRegression(process_from_dict(saved, kernel))

    return ResidualModel(name, description, fit, from_dict, candidate=candidate, complexity=complexity)


def _fit_like_fitrgp(data: TrainingData) -> Regression:
    return GaussianProcessRegression(fit_like_fitrgp(data.points, data.values), plug_in=True)


def _fitrgp_from_dict(saved: Mapping[str, Any]) -> Regression:
    return GaussianProcessRegression(process_from_dict(saved), plug_in=True)


GP: Final = gaussian_process_model(
    "gp",
    f"a Gaussian process with a constant and the kernel {MATERN_52.name}",
    "constant",
    candidate=True,
    complexity=5,
)
"""The residual `gp`."""

GP_ON_LINEAR: Final = gaussian_process_model(
    "gp_on_linear",
    f"a Gaussian process with a constant, slopes and the kernel {MATERN_52.name}",
    "linear",
    candidate=True,
    complexity=6,
)
"""The residual `gp_on_linear`."""

FITRGP: Final = ResidualModel(
    "fitrgp",
    f"the Gaussian process that MATLAB's fitrgp finds, with a constant and the kernel {MATERN_52.name}",
    _fit_like_fitrgp,
    _fitrgp_from_dict,
    complexity=7,
)
"""The residual `fitrgp`."""
