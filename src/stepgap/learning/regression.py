"""The seam for models of one number: the residual of one state coordinate, given a point and recorded steps."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array


class Prediction(NamedTuple):
    """What is expected of each of N values, and how far a noisy value may lie from it; shapes (N,)."""

    mean: Array
    std: Array


class Regression(ABC):
    """Predicts a value from a point of d inputs.

    Immutable: `append` gives another one. Points have shape (…, d); one that is not finite gives NaN.

    Attributes:
        kind: Its name in settings and files.
    """

    kind: str

    @property
    @abstractmethod
    def inputs(self) -> int:
        """Number of inputs d."""

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
    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Standard deviation; shape (…).

        Args:
            point: Shape (…, d).
            include_noise: False: of the expected value. True: of a new noisy value.
        """

    @abstractmethod
    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """∂std/∂point; shape (…, d)."""

    @abstractmethod
    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Each of the N values learnt from, as predicted from those outside its block, at the same hyper-parameters.

        Args:
            blocks: Consecutive parts of the N values.
        """

    @abstractmethod
    def append(self, point: ArrayLike, value: float) -> "Regression":
        """The same model with one more value, at the same hyper-parameters."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """JSON-ready data with the `kind`."""


@final
@dataclass(frozen=True)
class Zero(Regression):
    """No model: zero, and sure of it.

    Attributes:
        size: Number of inputs d.
        noise: How far noisy values lie from zero; 0 where that is not known.
    """

    kind = "none"
    size: int
    noise: float = 0.0

    @property
    def inputs(self) -> int:
        """As given."""
        return self.size

    @property
    def noise_std(self) -> float:
        """As given."""
        return self.noise

    def mean(self, point: ArrayLike) -> Array:
        """Zero; shape (…)."""
        return np.zeros(np.shape(point)[:-1])

    def mean_gradient(self, point: ArrayLike) -> Array:
        """Zero; shape (…, d)."""
        return np.zeros(np.shape(point))

    def std(self, point: ArrayLike, *, include_noise: bool = False) -> Array:
        """Zero, or that of the noise; shape (…)."""
        return self.mean(point) + (self.noise if include_noise else 0.0)

    def std_gradient(self, point: ArrayLike, *, include_noise: bool = False) -> Array:  # noqa: ARG002
        """Zero; shape (…, d)."""
        return self.mean_gradient(point)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Zero, with the noise of all values."""
        size = blocks[-1].stop
        return Prediction(np.zeros(size), np.full(size, self.noise))

    def append(self, point: ArrayLike, value: float) -> "Zero":  # noqa: ARG002
        """The same."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """The number of inputs, and the noise."""
        return {"kind": "none", "inputs": self.inputs, "noise_std": self.noise}
