"""Features that a function of the inputs computes, for a plug-in without anything to fit."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np

from stepgap.base.json_data import numbers
from stepgap.learning.feature_map import FeatureMap, FeatureModel
from stepgap.learning.regression import TrainingData
from stepgap.step import Array

_DIFFERENCE = 1e-5
"""Step of the central differences of a function without a Jacobian, in half ranges of the inputs."""


@final
@dataclass(frozen=True, eq=False)
class FunctionFeatures(FeatureMap):
    """Features that a function computes, less their middle and divided by half their range in the data.

    Attributes:
        function: From points (…, p) in SI units to features (…, k).
        derivative: Its Jacobian, from points (…, p) to (…, k, p); None to difference it.
        centre: Middle of each feature in the data; shape (k,).
        scale: Half its range there, 1 where it does not vary; shape (k,).
        input_scale: Half the range of use of each input; shape (p,).
    """

    function: Callable[[Array], Array]
    derivative: Callable[[Array], Array] | None
    centre: Array
    scale: Array
    input_scale: Array

    def features(self, point: Array) -> Array:
        """φ(point); shape (…, k)."""
        return (np.asarray(self.function(point), float) - self.centre) / self.scale

    def jacobian(self, point: Array) -> Array:
        """∂φ/∂point; shape (…, k, p)."""
        if self.derivative is not None:
            return np.asarray(self.derivative(point), float) / self.scale[:, None]
        steps = _DIFFERENCE * np.diag(self.input_scale)
        ahead, behind = (self.features(point[..., None, :] + sign * steps) for sign in (1.0, -1.0))
        return np.swapaxes(ahead - behind, -1, -2) / (2 * _DIFFERENCE * self.input_scale)

    def to_dict(self) -> dict[str, Any]:
        """Converts the scales to JSON-ready numbers; the function is that of the installed plug-in."""
        return {name: getattr(self, name).tolist() for name in ("centre", "scale", "input_scale")}


def function_features(
    name: str, function: Callable[[Array], Array], derivative: Callable[[Array], Array] | None = None
) -> FeatureModel:
    """Makes a plug-in of a function.

    Args:
        name: Name of the model, that of its entry point.
        function: From points (…, p) in SI units, which are states, commands and lagged inputs if there are any, to
            features (…, k); NaN where a point is.
        derivative: Its Jacobian, from points (…, p) to (…, k, p). By default, the function is differenced.
    """

    def fit(data: TrainingData) -> FeatureMap:
        found = np.asarray(function(data.points), float)
        if found.ndim != 2 or len(found) != len(data.points):
            raise ValueError(f"feature map {name!r}: returned the shape {found.shape}; it must be (steps, features)")
        lower, upper = found.min(axis=0), found.max(axis=0)
        scale = np.where(upper > lower, (upper - lower) / 2, 1.0)
        return FunctionFeatures(function, derivative, (lower + upper) / 2, scale, data.scale)

    def from_dict(saved: Mapping[str, Any]) -> FeatureMap:
        centre, scale, input_scale = (numbers(saved, key, 1) for key in ("centre", "scale", "input_scale"))
        if centre.shape != scale.shape or not (np.concatenate([scale, input_scale]) > 0).all():
            raise ValueError("scale and input_scale must be positive, and scale as long as centre")
        return FunctionFeatures(function, derivative, centre, scale, input_scale)

    return FeatureModel(name, fit, from_dict)
