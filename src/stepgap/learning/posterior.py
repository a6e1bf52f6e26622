"""The residual `posterior`: what the beliefs about a robot's error say of it, as a function of state and command.

Its value is that of another regression, if there is one, plus a weighted sum of features of state and command, whose
weights are normal. The features are common to all beliefs, so the mixture of these has exact first moments: the mean
and the covariance of the weights, which are all that a plan needs.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Final, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import LARGEST_NUMBER, as_object, integer, number, numbers
from stepgap.base.ranges import require
from stepgap.gauss.features import Features
from stepgap.learning.first_beliefs import features_of, unknown_belief
from stepgap.learning.regression import BatchRegression, Parameter, Prediction, Regression, ResidualModel, TrainingData
from stepgap.step import Array

NOISE_ROUNDS: Final = 3  # Number of rounds in which predictions of values that are left out find their noise
MOST_FEATURES_READ: Final = 1000  # Largest number of features that is read


@final
@dataclass(frozen=True, eq=False)
class Posterior(BatchRegression):
    """The error of one state coordinate, as far as it is known.

    Attributes:
        data: The steps that were learned from, for reports, and the ranges of the inputs.
        features: Features of the inputs `used`, in half ranges.
        mean_weights: Expected weights of the features, and of what follows them; shape (k,) [half ranges].
        covariance: Their covariance; shape (k, k) [half ranges²].
        side: What follows the features and does not depend on the inputs; shape (k − p,).
        noise: Standard deviation of a step's error about the expected one [half ranges].
        used: Numbers of the inputs that the features have.
        base: Regression with the same inputs to which all of this is added; None for none.
    """

    features: Features
    mean_weights: Array
    covariance: Array
    side: Array
    noise: float
    used: tuple[int, ...]
    base: Regression | None = None

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one."""
        return self.noise * self.data.value_scale

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        own = self.data.value_scale * (self._features(point) @ self._own + self._constant)
        return own + self.base.mean(point) if self.base else own

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        own = self._by_point(np.einsum("...pd,p->...d", self._gradient(point), self._own), point)
        return own + self.base.mean_gradient(point) if self.base else own

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation; shape (…)."""
        own = self.data.value_scale * self._own_std(point)[1]
        return np.hypot(own, self.base.std(point)) if self.base else own

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""
        product, std = self._own_std(point)
        count = self.features.count
        slopes = np.einsum("...pd,...p->...d", self._gradient(point), product[..., :count])
        own = self._by_point(
            np.divide(slopes, std[..., None], out=np.zeros_like(slopes), where=std[..., None] != 0), point
        )
        if self.base is None:
            return own
        # std² = own² + base², so its derivative has each part in proportion.
        parts = self.data.value_scale * std, self.base.std(point)
        total = np.hypot(*parts)
        shares = [np.divide(part, total, out=np.zeros_like(total), where=total != 0)[..., None] for part in parts]
        return shares[0] * own + shares[1] * self.base.std_gradient(point)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions, with noise, of each value from those outside its block, as if all had been learned equally.

        The weights are those of a robot of which nothing was known: what a value said to several beliefs that compete
        cannot be taken back. Nothing is known of the steps before, so the noise is that of all values about the
        features of their points (predicted residual sum of squares: Allen, 1974).
        """
        rows = self._features(self.points)
        unit = self.data.value_scale
        values = (self.values - (self.base.mean(self.points) if self.base else 0.0)) / unit
        prior = unknown_belief(self.features)
        information = np.linalg.inv(prior.weights.covariance[0])
        noise = self.noise**2
        influence = np.empty((0, 0))
        error = values
        for _ in range(NOISE_ROUNDS):
            spread = np.linalg.inv(information + rows.T @ rows / noise)
            influence = rows @ spread / noise
            error = values - influence @ (rows.T @ values)
            freedom = float(prior.freedom[0]) - 2 + len(values) - float(np.sum(influence * rows))
            noise = (float(prior.squares[0]) + float(error @ error)) / freedom
        mean = np.empty(len(values))
        std = np.empty(len(values))
        for block in blocks:
            kept = np.eye(len(rows[block])) - influence[block] @ rows[block].T
            mean[block] = self.values[block] - unit * np.linalg.solve(kept, error[block])
            std[block] = unit * np.sqrt(noise * np.diag(np.linalg.inv(kept)))
        return Prediction(mean, std)

    def append(self, point: ArrayLike, value: float) -> "Posterior":
        """Conditions the weights on one more value."""
        point = np.asarray(point, float)
        product, std = self._own_std(point)
        gain = product / (std**2 + self.noise**2)
        error = (value - float(self.mean(point))) / self.data.value_scale
        return replace(
            self,
            data=self.data.append(point, value),
            mean_weights=self.mean_weights + gain * error,
            covariance=self.covariance - np.outer(gain, product),
        )

    def parameters(self) -> list[Parameter]:
        """Noise, and the value and slopes in the middle of the range of use."""
        middle = self.data.centre
        centre = "in the middle"
        slopes = Parameter(f"slope {centre}", self.mean_gradient(middle), "value per input")
        return [*super().parameters(), Parameter(centre, float(self.mean(middle)), "value"), slopes]

    def to_dict(self) -> dict[str, Any]:
        """Converts the regression to JSON-ready data; that of `base` is the model's own."""
        return {
            **self.data.to_dict(),
            "features": features_to_dict(self.features),
            "weights": self.mean_weights.tolist(),
            "covariance": self.covariance.tolist(),
            "noise": self.noise,
            "used": list(self.used),
        }

    @property
    def _own(self) -> Array:
        """Expected weights of the features that depend on the inputs; shape (p,)."""
        return self.mean_weights[: self.features.count]

    @cached_property
    def _constant(self) -> float:
        return float(self.side @ self.mean_weights[self.features.count :])

    def _own_std(self, point: ArrayLike) -> tuple[Array, Array]:
        """Covariance of the weights with the sum, (…, k), and standard deviation of the sum, (…) [half ranges]."""
        features = self._features(point)
        side = np.broadcast_to(self.side, (*features.shape[:-1], len(self.side)))
        rows = np.concatenate([features, side], axis=-1)
        product = rows @ self.covariance
        return product, np.sqrt(np.maximum(np.sum(product * rows, axis=-1), 0.0))

    def _scaled(self, point: ArrayLike) -> Array:
        scaled = self.data.scaled(point)
        return np.where(np.isfinite(scaled).all(axis=-1, keepdims=True), scaled[..., self.used], np.nan)

    def _features(self, point: ArrayLike) -> Array:
        return self.features(self._scaled(point))

    def _gradient(self, point: ArrayLike) -> Array:
        return self.features.gradient(self._scaled(point))

    def _by_point(self, slopes: Array, point: ArrayLike) -> Array:
        """Derivatives by the inputs from those by the scaled inputs of the features; (…, used) to (…, d)."""
        derivatives = np.zeros((*np.shape(point)[:-1], self.inputs))
        derivatives[..., self.used] = slopes
        return derivatives * (self.data.value_scale / self.data.scale)


def posterior_from_dict(saved: Mapping[str, Any]) -> Posterior:
    """Restores what `Posterior.to_dict` saved; a ValueError names the wrong key."""
    data = TrainingData.from_dict(saved)
    try:
        features = features_from_dict(as_object(saved.get("features"), "features"))
    except ValueError as error:
        raise ValueError(f"features {str(error).removeprefix('features').lstrip('. ')}") from None
    weights = numbers(saved, "weights", 1)
    covariance = numbers(saved, "covariance", 2)
    size = len(weights)
    used = tuple(int(index) for index in numbers(saved, "used", 1))
    require(size >= features.count, "weights", weights, f"have at least {features.count} numbers")
    require(covariance.shape == (size, size), "covariance.shape", covariance.shape, f"be {(size, size)}")
    require(len(used) == features.inputs, "used", used, f"have {features.inputs} numbers")
    require(
        all(0 <= index < len(data.scale) for index in used), "used", used, f"lie between 0 and {len(data.scale) - 1}"
    )
    noise = number(saved, "noise")
    require(noise > 0, "noise", noise, "be positive")
    return Posterior(data, features, weights, covariance, np.zeros(size - features.count), noise, used)


def features_to_dict(features: Features) -> dict[str, Any]:
    """Converts features to JSON-ready data, which `features_from_dict` reads."""
    return {
        "inputs": features.inputs,
        "degree": features.degree,
        "frequencies": features.frequencies.tolist(),
        "shifts": features.shifts.tolist(),
    }


def features_from_dict(saved: Mapping[str, Any]) -> Features:
    """Restores features; a ValueError names the wrong key."""
    inputs = integer(saved, "inputs")
    degree = integer(saved, "degree")
    shifts = numbers(saved, "shifts", 1)
    require(1 <= inputs <= MOST_FEATURES_READ, "features.inputs", inputs, f"lie between 1 and {MOST_FEATURES_READ}")
    require(degree in (1, 2), "features.degree", degree, "be 1 or 2")
    frequencies = numbers(saved, "frequencies", 2) if len(shifts) else np.empty((0, inputs))
    expected = (len(shifts), inputs)
    require(frequencies.shape == expected, "features.frequencies.shape", frequencies.shape, f"be {expected}")
    largest = float(np.abs(frequencies).max(initial=0.0))
    require(largest <= LARGEST_NUMBER, "features.frequencies", largest, f"be at most {LARGEST_NUMBER:g}")
    features = Features(inputs, degree, frequencies, shifts)
    require(
        features.count <= MOST_FEATURES_READ, "features.inputs", inputs, f"give at most {MOST_FEATURES_READ} features"
    )
    return features


def _fit(data: TrainingData) -> Posterior:
    """Conditions the weights of a robot of which nothing is known on the data, with the noise that these show."""
    inputs = len(data.scale) - data.timed
    features = features_of(inputs, len(data.values))
    belief = unknown_belief(features)
    points = data.scaled(data.points)[:, :inputs]
    values = data.values / data.value_scale
    for row, value in zip(features(points), values, strict=True):
        belief = belief.learned(row, np.array([value]), 1.0)
    weights = unknown_belief(features).weights  # again, since the noise was not known from the first value on
    for row, value in zip(features(points), values, strict=True):
        weights = weights.learned(row, np.array([value]), belief.noise)
    mean = weights.mean[0]
    covariance = weights.covariance[0]
    noise = float(np.sqrt(belief.noise[0]))
    return Posterior(data, features, mean, covariance, np.zeros(0), noise, used=tuple(range(inputs)))


POSTERIOR: Final = ResidualModel(
    "posterior",
    "the mixture of what is believed: a polynomial, and a smooth part where many steps are known",
    _fit,
    posterior_from_dict,
    candidate=True,
    complexity=5,
)
"""The residual `posterior`."""
