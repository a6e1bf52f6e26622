"""Feature maps: functions z = φ(x) that come before the inputs of a regression, to which it is then fitted.

A `FeatureModel` is a plug-in: it has a name, and fits a `FeatureMap` to the training data of a regression.
`with_features` makes a residual model of it and any other one, whose regressions are functions of x again: their
gradients follow by the chain rule. x has all inputs but the time.

Features may leave out a part of x, and the regression on them does not know how the error depends on that part. So
`with_features` adds to its variance that of a linear function of the part left out, fitted to the same data with the
prior of `polynomial`: far from all data, the standard deviation grows in every direction of x.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.json_data import as_object, numbers
from stepgap.learning.polynomial import PRIOR_STD
from stepgap.learning.regression import Parameter, Prediction, Regression, ResidualModel, TrainingData
from stepgap.step import Array

_Part = TypeVar("_Part")


class FeatureMap(ABC):
    """A map φ from p inputs to k features; immutable.

    Features have no unit and change by about 1 over the range of use. Points have shape (…, p); those that are not
    finite have features that are not.
    """

    @abstractmethod
    def features(self, point: Array) -> Array:
        """φ(point); shape (…, k)."""

    @abstractmethod
    def jacobian(self, point: Array) -> Array:
        """∂φ/∂point; shape (…, k, p)."""

    @abstractmethod
    def to_dict(self) -> dict[str, Any]:
        """Converts what was fitted to JSON-ready numbers, which `FeatureModel.from_dict` reads."""


@final
@dataclass(frozen=True)
class FeatureModel:
    """A kind of feature map that is selected by its name; an entry point of `stepgap.feature_maps` refers to it.

    Attributes:
        name: Name in settings, files and reports; that of its entry point.
        fit: Fits the feature map of a regression to its data, at least one value, without the time.
        from_dict: Restores the map that `FeatureMap.to_dict` saved; its ValueError names the wrong key.
    """

    name: str
    fit: Callable[[TrainingData], FeatureMap]
    from_dict: Callable[[Mapping[str, Any]], FeatureMap]


@final
@dataclass(frozen=True, eq=False)
class LeftOutPart:
    """The part of the inputs that does not follow from their features: u = s − b − Bᵀ z, with scaled inputs s.

    Attributes:
        centre: Middle of the range of use of each input; shape (p,).
        scale: Half that range; shape (p,).
        reconstruction: b and B, by which the inputs are best reconstructed from the features of the data; (1 + k, p).
        root: A root of σ² (UᵀU + 1 / PRIOR_STD²)⁻¹, the covariance of a linear function of u, where U are the left-out
            parts of the data and σ is the noise; shape (p, p).
    """

    centre: Array
    scale: Array
    reconstruction: Array
    root: Array

    @classmethod
    def fit(cls, data: TrainingData, features: Array, noise_std: float) -> "LeftOutPart":
        """Finds it for data of p inputs, their features (N, k), and the noise of a value."""
        scaled, basis = data.scaled(data.points), np.insert(features, 0, 1.0, axis=1)
        reconstruction = np.asarray(np.linalg.lstsq(basis, scaled)[0], float)
        part = scaled - basis @ reconstruction
        values, vectors = np.linalg.eigh(part.T @ part)
        root = noise_std * vectors / np.sqrt(np.maximum(values, 0.0) + PRIOR_STD**-2) @ vectors.T
        return cls(data.centre, data.scale, reconstruction, root)

    def std(self, point: Array, features: Array) -> Array:
        """Standard deviation of the linear function of u; shape (…)."""
        return np.linalg.norm(self._weighted(point, features), axis=-1)

    def half_variance_gradient(self, point: Array, features: Array, jacobian: Array) -> Array:
        """½ ∂std²/∂point; shape (…, p)."""
        weighted = self._weighted(point, features) @ self.root.T
        by_features = weighted @ self.reconstruction[1:].T
        return weighted / self.scale - np.einsum("...k,...kp->...p", by_features, jacobian)

    def to_dict(self) -> dict[str, Any]:
        """Converts it to JSON-ready numbers."""
        return {name: getattr(self, name).tolist() for name in ("centre", "scale", "reconstruction", "root")}

    @classmethod
    def from_dict(cls, saved: Mapping[str, Any]) -> "LeftOutPart":
        """Restores what `to_dict` saved; a ValueError names the wrong key."""
        dimensions = {"centre": 1, "scale": 1, "reconstruction": 2, "root": 2}
        part = cls(*(numbers(saved, name, each) for name, each in dimensions.items()))
        size = len(part.centre)
        fits = part.scale.shape == (size,) and part.reconstruction.shape[1] == size and part.root.shape == (size, size)
        if not fits or not (part.scale > 0).all():
            raise ValueError(f"centre, scale, reconstruction and root must fit together, for {size} inputs")
        return part

    def _weighted(self, point: Array, features: Array) -> Array:
        scaled = (point - self.centre) / self.scale
        return (scaled - self.reconstruction[0] - features @ self.reconstruction[1:]) @ self.root


@final
@dataclass(frozen=True, eq=False)
class FeatureRegression(Regression):
    """A regression on features, and on the time if it has one, as a function of the inputs.

    Attributes:
        map: The feature map.
        left_out_part: What it leaves out of the inputs.
        inner: The regression on features.
        fitted: Inputs that it was fitted to, before the feature map; shape (N, d).
    """

    map: FeatureMap
    left_out_part: LeftOutPart
    inner: Regression
    fitted: Array

    @property
    def points(self) -> Array:
        """Inputs that it was fitted to, before the feature map; shape (N, d)."""
        return self.fitted

    @property
    def values(self) -> Array:
        """Values that it was fitted to; shape (N,)."""
        return self.inner.values

    @property
    def noise_std(self) -> float:
        """Standard deviation of a new value about the expected one."""
        return self.inner.noise_std

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self.inner.mean(self._split(point)[-1])

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        x, _, inputs = self._split(point)
        return _by_point(self.inner.mean_gradient(inputs), self.map.jacobian(x))

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation of the expected value, which includes what the features leave out; shape (…)."""
        x, features, inputs = self._split(point)
        return np.hypot(self.inner.std(inputs), self.left_out_part.std(x, features))

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""
        x, features, inputs = self._split(point)
        jacobian, std = self.map.jacobian(x), self.std(point)[..., None]
        half = self.inner.std(inputs)[..., None] * _by_point(self.inner.std_gradient(inputs), jacobian)
        half[..., : x.shape[-1]] += self.left_out_part.half_variance_gradient(x, features, jacobian)
        return np.divide(half, std, out=np.zeros_like(half), where=std != 0)

    def left_out(self, blocks: Sequence[slice]) -> Prediction:
        """Predictions, with noise, of each value from those outside its block, with the same feature map."""
        mean, std = self.inner.left_out(blocks)
        x, features, _ = self._split(self.fitted)
        return Prediction(mean, np.hypot(std, self.left_out_part.std(x, features)))

    def append(self, point: ArrayLike, value: float) -> "FeatureRegression":
        """Conditions the regression on one more value, with the same feature map."""
        inner = self.inner.append(self._split(point)[-1], value)
        return replace(self, inner=inner, fitted=np.vstack([self.fitted, np.asarray(point, float)]))

    def to_dict(self) -> dict[str, Any]:
        """That of the regression on features, with the inputs before the feature map, and what was fitted of it."""
        of_map = {"feature_map": self.map.to_dict(), "left_out_part": self.left_out_part.to_dict()}
        return {**self.inner.to_dict(), "points": self.fitted.tolist(), **of_map}

    def parameters(self) -> list[Parameter]:
        """Those parameters that do not belong to single features, and the number of features."""
        common = [parameter for parameter in self.inner.parameters() if not np.ndim(parameter.value)]
        meaning = "The model has features of the inputs instead of the inputs, as the setting feature_map says."
        return [*common, Parameter("features", len(self.left_out_part.reconstruction) - 1, "", meaning)]

    def _split(self, point: ArrayLike) -> tuple[Array, Array, Array]:
        """Inputs of the map (…, p), features (…, k), and inputs of the regression: features, and the time if any."""
        point = np.asarray(point, float)
        size = len(self.left_out_part.centre)
        return point[..., :size], *_features(self.map, point, size)


def with_features(model: ResidualModel, features: FeatureModel) -> ResidualModel:
    """Returns the residual model whose regressions are those of another one on features; it has the same name."""

    def fit(data: TrainingData, start: Regression | None) -> Regression:
        size = len(data.scale) - data.timed
        timeless = replace(
            data, points=data.points[:, :size], centre=data.centre[:size], scale=data.scale[:size], timed=False
        )
        found = features.fit(timeless)
        of_points, inputs = _features(found, data.points, size)
        count = of_points.shape[1]
        centre = np.concatenate([np.zeros(count), data.centre[size:]])
        scale = np.concatenate([np.ones(count), data.scale[size:]])
        former = start.inner if isinstance(start, FeatureRegression) else None
        inner = model.fit(
            replace(data, points=inputs, centre=centre, scale=scale),
            former if former is not None and former.inputs == inputs.shape[1] else None,
        )
        return FeatureRegression(found, LeftOutPart.fit(timeless, of_points, inner.noise_std), inner, data.points)

    def from_dict(saved: Mapping[str, Any]) -> Regression:
        points = numbers(saved, "points", 2)
        found = _part(saved, "feature_map", features.from_dict)
        left_out_part = _part(saved, "left_out_part", LeftOutPart.from_dict)
        size, count = len(left_out_part.centre), len(left_out_part.reconstruction) - 1
        if points.shape[1] not in (size, size + 1):
            raise ValueError(f"points must have {size} columns, or one more for the time, not {points.shape[1]}")
        try:
            of_points, inputs = _features(found, points, size)
        except ValueError:
            raise ValueError(f"feature_map does not take {size} inputs, as left_out_part does") from None
        if of_points.shape[1] != count:
            raise ValueError(f"feature_map has {of_points.shape[1]} features, and left_out_part {count}")
        return FeatureRegression(found, left_out_part, model.from_dict({**saved, "points": inputs.tolist()}), points)

    return replace(model, fit=fit, from_dict=from_dict)


def _part(saved: Mapping[str, Any], key: str, restore: Callable[[Mapping[str, Any]], _Part]) -> _Part:
    """Restores a part of a saved regression; a ValueError names its key."""
    found = as_object(saved.get(key), key)
    try:
        return restore(found)
    except ValueError as error:
        raise ValueError(f"{key} is not valid: {error}") from None


def _features(feature_map: FeatureMap, point: Array, size: int) -> tuple[Array, Array]:
    """Features (…, k) of points (…, d), and these with the inputs after the first `size`, which a map does not have."""
    features = feature_map.features(point[..., :size])
    return features, np.concatenate([features, point[..., size:]], axis=-1)


def _by_point(gradient: Array, jacobian: Array) -> Array:
    """A gradient by the inputs of the regression on features (…, k + 1 or k) as one by the point (…, d)."""
    count = jacobian.shape[-2]
    by_point = np.einsum("...k,...kp->...p", gradient[..., :count], jacobian)
    return np.concatenate([by_point, gradient[..., count:]], axis=-1)
