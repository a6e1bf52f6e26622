"""The interface of residual models: a regression for the residual of one state coordinate, and how it is fitted.

A `ResidualModel` is a plug-in: it has a name, and fits a `Regression` to the `TrainingData` of each state coordinate.
`BatchRegression` does most of the work for a model that is computed from all data at once; docs/extensions.md has an
example.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Self, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import boolean, number, numbers
from stepgap.base.ranges import require
from stepgap.step import Array


class Prediction(NamedTuple):
    """Expected values, and standard deviations of noisy values about them; shapes (N,)."""

    mean: Array
    std: Array


class Parameter(NamedTuple):
    """A number that describes a regression, for the report.

    Attributes:
        name: Name for the report, such as "length scale".
        value: One number, or one for each of the d inputs; shape (d,).
        unit: Unit of the regression's values, of each input, of values per input, or none.
        meaning: A sentence that explains it, if it needs one.
    """

    name: str
    value: float | Array
    unit: Literal["value", "input", "value per input", ""]
    meaning: str = ""


@final
@dataclass(frozen=True, eq=False)
class TrainingData:
    """Data that a regression is fitted to: N values of the residual of one state coordinate, in their order.

    Attributes:
        points: Inputs: state, command and history inputs, concatenated; shape (N, d).
        values: Shape (N,).
        centre: Middle of the range of use of each input; shape (d,).
        scale: Half that range; shape (d,).
        value_scale: Half the range of use of the state coordinate.
        timed: Whether the last input is a time, in units of the forgetting time, which never falls.

    Raises:
        ValueError: A wrong shape, a number that is not finite, or a scale that is not positive.
    """

    points: Array
    values: Array
    centre: Array
    scale: Array
    value_scale: float
    timed: bool = False

    def __post_init__(self) -> None:
        require(self.scale.ndim == 1, "scale.shape", self.scale.shape, "be (d,)")
        require(self.points.ndim == 2, "points.shape", self.points.shape, "be (N, d)")
        size = len(self.points)
        inputs = len(self.scale)
        shapes = {"scale": (inputs,), "centre": (inputs,), "points": (size, inputs), "values": (size,)}
        for name, shape in shapes.items():
            array = getattr(self, name)
            require(array.shape == shape, f"{name}.shape", array.shape, f"be {shape}")
            require(np.isfinite(array).all(), name, array, "be finite")
        require((self.scale > 0).all(), "scale", self.scale, "be positive")
        require(0 < self.value_scale < np.inf, "value_scale", self.value_scale, "be positive and finite")

    def scaled(self, point: ArrayLike) -> Array:
        """Converts points (…, d) to half ranges from the centre; shape (…, d)."""
        return (np.asarray(point, float) - self.centre) / self.scale

    def append(self, point: ArrayLike, value: float) -> "TrainingData":
        """Returns the data with one more point (d,) and its value."""
        points = np.vstack([self.points, np.asarray(point, float)])
        return replace(self, points=points, values=np.append(self.values, value))

    def without(self, block: slice) -> "TrainingData":
        """Returns the data outside a block."""
        kept = np.delete(np.arange(len(self.values)), block)
        return replace(self, points=self.points[kept], values=self.values[kept])

    def to_dict(self) -> dict[str, Any]:
        """Converts the data to JSON-ready numbers, which `from_dict` reads."""
        arrays = {name: getattr(self, name).tolist() for name in ("points", "values", "centre", "scale")}
        return {**arrays, "value_scale": self.value_scale, "timed": self.timed}

    @staticmethod
    def from_dict(saved: Mapping[str, Any]) -> "TrainingData":
        """Restores the data that `to_dict` saved; a ValueError names the wrong key."""
        centre = numbers(saved, "centre", 1)
        return TrainingData(
            np.empty((0, len(centre))) if saved.get("points") == [] else numbers(saved, "points", 2),
            numbers(saved, "values", 1),
            centre,
            numbers(saved, "scale", 1),
            number(saved, "value_scale"),
            boolean(saved, "timed"),
        )


class Regression(ABC):
    """A regression: it predicts a value from a point of d inputs, given the data that it was fitted to.

    Immutable: `append` returns a new one. Points have shape (…, d); a point that is not finite gives NaN.
    """

    @property
    @abstractmethod
    def points(self) -> Array:
        """Inputs that it was fitted to; shape (N, d)."""

    @property
    @abstractmethod
    def values(self) -> Array:
        """Values that it was fitted to; shape (N,)."""

    @property
    @abstractmethod
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one."""

    @abstractmethod
    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""

    @abstractmethod
    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""

    @abstractmethod
    def std(self, point: ArrayLike) -> Array:
        """Standard deviation of the expected value, without the noise of a new one; shape (…)."""

    @abstractmethod
    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""

    @abstractmethod
    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions, with noise, of each of the N values from those outside its block, at the same hyper-parameters.

        Args:
            blocks: Consecutive parts of the N values. A block of all values leaves no data for its prediction.
        """

    @abstractmethod
    def append(self, point: ArrayLike, value: float) -> "Regression":
        """Conditions the model on one more value, at the same hyper-parameters."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Converts the regression to JSON-ready data, which `ResidualModel.from_dict` reads."""

    @property
    def inputs(self) -> int:
        """Number of inputs d."""
        return self.points.shape[1]

    def predict(self, point: ArrayLike) -> Prediction:
        """Mean and standard deviation of a new noisy value; shapes (…) and (…)."""
        return Prediction(self.mean(point), np.hypot(self.std(point), self.noise_std))

    def parameters(self) -> list[Parameter]:
        """Parameters for the report."""
        meaning = "Noise is the scatter that the model expects of a step repeated under equal conditions."
        return [Parameter("noise", self.noise_std, "value", meaning)]


@dataclass(frozen=True, eq=False)
class BatchRegression(Regression):
    """A regression that is computed from all its data at once.

    A subclass is a frozen dataclass, too. Its further fields are hyper-parameters; everything else must follow from
    them and the data, for instance in a `cached_property`. `append` and `left_out` then need not be implemented: they
    replace `data`.

    Attributes:
        data: Data that it was fitted to.
    """

    data: TrainingData

    @property
    def points(self) -> Array:
        """Inputs that it was fitted to; shape (N, d)."""
        return self.data.points

    @property
    def values(self) -> Array:
        """Values that it was fitted to; shape (N,)."""
        return self.data.values

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predicts each value from those outside its block; costs as much as computing the model once per block."""
        mean = np.full(len(self.values), np.nan)
        std = np.full(len(self.values), np.inf)
        for block in blocks:
            if len(self.values[block]) < len(self.values):
                others = replace(self, data=self.data.without(block))
                mean[block], std[block] = others.predict(self.points[block])
        return Prediction(mean, std)

    def append(self, point: ArrayLike, value: float) -> Self:
        """Conditions the model on one more value; costs as much as computing the model once."""
        return replace(self, data=self.data.append(point, value))


@final
@dataclass(frozen=True)
class ResidualModel:
    """A residual model that is selected by its name; an entry point of the group `stepgap.residuals` refers to it.

    Attributes:
        name: Name in settings, files and reports; that of its entry point.
        description: Description of the regression for the report, such as "a quadratic polynomial".
        fit: Fits the regression of one state coordinate to data with at least one value.
        from_dict: Restores the regression that `Regression.to_dict` saved; its ValueError names the wrong key.
        candidate: Whether `auto` may choose it.
        complexity: Rank from simple to complex: 0 none, 1 constant, 2 linear, 3 quadratic, 4 quadratic with a prior, 5
            to 7 Gaussian processes.
            Residuals are listed in this order, and among equally good ones the simplest is chosen.
    """

    name: str
    description: str
    fit: Callable[[TrainingData], Regression]
    from_dict: Callable[[Mapping[str, Any]], Regression]
    candidate: bool = False
    complexity: int = 10
