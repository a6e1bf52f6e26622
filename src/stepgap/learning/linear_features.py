"""Linear features: the directions of the inputs along which the error changes, learned from the data.

Many numbers of a state may say the same, such as the angles of joints that move together, or nothing about the error. A
Gaussian process of the error with one length scale for all inputs has the gradients gᵢ at the data. The features are
the components of the scaled inputs along the leading eigenvectors of Σ gᵢ gᵢᵀ, the *active subspace* (Constantine,
Active Subspaces, 2015; the same matrix is learned by the machines of Radhakrishnan et al., Mechanism for feature
learning, Science, 2024). How many are kept is chosen by cross-validation.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, Final, final

import numpy as np

from stepgap.base.json_data import numbers
from stepgap.base.normal import log_density
from stepgap.gauss.exact_gaussian_process import condition
from stepgap.gauss.gaussian_process import HyperParameters
from stepgap.gauss.gaussian_process_fit import fit_hyper_parameters
from stepgap.learning.feature_map import FeatureMap, FeatureModel
from stepgap.learning.regression import TrainingData
from stepgap.step import Array

KEPT: Final = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16, 20, 24, 32, 40, 50)
"""Numbers of features that are tried, besides that of all inputs."""

_FOLDS: Final = 5
"""Number of contiguous parts of the data, each predicted from the others, by which the number of features is chosen."""

LEAST_VALUES: Final = 20
"""Number of values below which the features are all inputs."""

_MOST_VALUES: Final = 300
"""Number of values, evenly spaced in the data, from which directions are learned."""


@final
@dataclass(frozen=True, eq=False)
class LinearFeatures(FeatureMap):
    """z = matrix · (point − centre), where centre is the middle of the ranges of use.

    Attributes:
        centre: Shape (p,).
        matrix: Directions, orthonormal in half ranges; shape (k, p).
    """

    centre: Array
    matrix: Array

    def features(self, point: Array) -> Array:
        """φ(point); shape (…, k)."""
        return (point - self.centre) @ self.matrix.T

    def jacobian(self, point: Array) -> Array:
        """∂φ/∂point, which is the matrix; shape (…, k, p)."""
        return np.broadcast_to(self.matrix, (*point.shape[:-1], *self.matrix.shape))

    def to_dict(self) -> dict[str, Any]:
        """Converts centre and matrix to JSON-ready numbers."""
        return {"centre": self.centre.tolist(), "matrix": self.matrix.tolist()}


def fit_linear_features(data: TrainingData) -> LinearFeatures:
    """Learns the directions, and how many, from data; if there are few, the features are all inputs."""
    count, inputs = len(data.values), len(data.scale)
    some = np.unique(np.linspace(0, count - 1, min(count, _MOST_VALUES)).astype(np.intp))
    # With more inputs, points lie farther apart: the prior of the length scale is that of four inputs.
    points, values = data.scaled(data.points)[some] * 2 / np.sqrt(inputs), data.values[some]
    directions = np.eye(inputs)
    if count >= LEAST_VALUES:
        found = fit_hyper_parameters(
            points, values, np.ones(inputs), data.value_scale, basis="linear", one_length_scale=True
        )
        directions = active_directions(points, values, found)[: _best_count(points, values, found)]
    matrix = np.ascontiguousarray(directions / data.scale)  # as a file restores it, so that it gives the same bits
    return LinearFeatures(data.centre, matrix)


def active_directions(points: Array, values: Array, hyper_parameters: HyperParameters) -> Array:
    """Directions along which the mean of a process changes, from the one of most change on; shape (p, p).

    Args:
        points: Inputs of one scale; shape (N, p).
        values: Shape (N,).
        hyper_parameters: Those of the process, for the input scale 1.
    """
    inputs = points.shape[1]
    gradient = condition(points, values, np.ones(inputs), hyper_parameters).mean_gradient(points)
    _, vectors = np.linalg.eigh(gradient.T @ gradient)
    directions = vectors.T[::-1]
    largest = np.abs(directions).argmax(axis=1)
    return directions * np.sign(directions[np.arange(inputs), largest])[:, None]


def _best_count(points: Array, values: Array, hyper_parameters: HyperParameters) -> int:
    """Least number of directions with which the values of each part are predicted from the others as well as possible.

    That is, within one standard error of the best mean log density (Breiman et al., Classification and Regression
    Trees, 1984, Sec. 3.4.3). Each part has its own directions; the hyper-parameters are those of all values.
    """
    counts = [*(count for count in KEPT if count < points.shape[1]), points.shape[1]]
    scores = np.empty((len(counts), len(values)))
    for part in np.array_split(np.arange(len(values)), _FOLDS):
        known, value = np.delete(points, part, axis=0), np.delete(values, part)
        directions = active_directions(known, value, hyper_parameters)
        for row, count in enumerate(counts):
            found = replace(hyper_parameters, length_scale=hyper_parameters.length_scale[:count])
            process = condition(known @ directions[:count].T, value, np.ones(count), found)
            held_out = points[part] @ directions[:count].T
            std = process.kriging_std(held_out, include_noise=True)
            scores[row, part] = log_density(values[part] - process.mean(held_out), std)
    loss = scores[scores.mean(axis=1).argmax()] - scores
    enough = loss.mean(axis=1) <= loss.std(axis=1) / np.sqrt(len(values))
    return counts[int(enough.argmax())]


def _from_dict(saved: Mapping[str, Any]) -> LinearFeatures:
    centre, matrix = numbers(saved, "centre", 1), numbers(saved, "matrix", 2)
    if matrix.shape[1] != len(centre):
        raise ValueError(f"matrix must have {len(centre)} columns, as centre has numbers, not {matrix.shape[1]}")
    return LinearFeatures(centre, matrix)


LINEAR_FEATURES: Final = FeatureModel("linear", fit_linear_features, _from_dict)
"""The feature map `linear`."""
