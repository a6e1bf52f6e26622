"""A small ensemble of neural networks as a residual, with the networks of scikit-learn.

Five networks of two layers of 32 tanh units are fitted to bootstrap samples. Their mean is the prediction, their
standard deviation its uncertainty, and the error at points that a network has not seen is the noise.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.util import find_spec
from typing import Any, NamedTuple, final
from warnings import catch_warnings, simplefilter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.learning.trial import Trial
from stepgap.base.blas import one_blas_thread
from stepgap.learning.observations import observe
from stepgap.learning.polynomial import NOISE_SCALE
from stepgap.learning.regression import BatchRegression, ResidualModel, TrainingData
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.step import Array

SKLEARN_MISSING = "" if find_spec("sklearn") else "needs the package scikit-learn"
"""Why the ensemble cannot be used; empty if it can."""

NETWORKS = 5
HIDDEN_UNITS = (32, 32)
DECAY = 0.1
"""Penalty on the weights, scikit-learn's `alpha`."""
MOST_ITERATIONS = 300


class Layer(NamedTuple):
    """One layer: weights (inputs, units) and bias (units,)."""

    weights: Array
    bias: Array


class Network(NamedTuple):
    """A network with tanh units and a linear last layer.

    Attributes:
        layers: From the inputs to the value.
        unseen: Whether each of the N values was left out of its bootstrap sample; shape (N,).
    """

    layers: tuple[Layer, ...]
    unseen: NDArray[np.bool_]

    def value_and_gradient(self, inputs: Array) -> tuple[Array, Array]:
        """Values (…) and their gradients (…, d) at inputs (…, d)."""
        gradient = np.broadcast_to(np.eye(inputs.shape[-1]), (*inputs.shape, inputs.shape[-1]))
        values = inputs
        for layer in self.layers[:-1]:
            values = np.tanh(values @ layer.weights + layer.bias)
            gradient = gradient @ layer.weights * (1 - values**2)[..., None, :]
        last = self.layers[-1]
        return (values @ last.weights + last.bias)[..., 0], (gradient @ last.weights)[..., 0]


@final
@dataclass(frozen=True, eq=False)
class Ensemble(BatchRegression):
    """The ensemble; it is trained when it is first used, with fixed seeds."""

    @property
    def noise_std(self) -> float:
        """Root-mean-square error of the networks at the values that they have not seen."""
        return self._noise_std

    def mean(self, point: ArrayLike) -> Array:
        """Expected value; shape (…)."""
        return self._values_and_gradients(point)[0].mean(axis=0)

    def mean_gradient(self, point: ArrayLike) -> Array:
        """∂mean/∂point; shape (…, d)."""
        return self._values_and_gradients(point)[1].mean(axis=0)

    def std(self, point: ArrayLike) -> Array:
        """Standard deviation between the networks; shape (…)."""
        return self._values_and_gradients(point)[0].std(axis=0, ddof=1)

    def std_gradient(self, point: ArrayLike) -> Array:
        """∂std/∂point; shape (…, d)."""
        values, gradients = self._values_and_gradients(point)
        deviation = (values - values.mean(axis=0))[..., None]
        half = np.sum(deviation * gradients, axis=0) / (NETWORKS - 1)  # the deviations add up to zero
        std = values.std(axis=0, ddof=1)[..., None]
        return np.divide(half, std, out=np.zeros_like(half), where=std != 0)

    def to_dict(self) -> dict[str, Any]:
        """Converts the data to JSON-ready numbers; the networks follow from them."""
        return self.data.to_dict()

    @cached_property
    def _networks(self) -> tuple[Network, ...]:
        return tuple(_trained(self.data.scaled(self.points), self._normalised, seed) for seed in range(NETWORKS))

    @cached_property
    def _noise_std(self) -> float:
        """Also holds, like a single value, the prior scale of a step's noise, so that it is never zero."""
        scaled, prior = self.data.scaled(self.points), NOISE_SCALE * self.data.value_scale
        errors = [
            self._spread * (network.value_and_gradient(scaled)[0] - self._normalised)[network.unseen]
            for network in self._networks
        ]
        squares = np.concatenate(errors) ** 2
        return float(np.sqrt((squares.sum() + prior**2) / (len(squares) + 1)))

    @property
    def _spread(self) -> float:
        """Standard deviation of the values, at least the prior scale of a step's noise."""
        return max(float(self.values.std()), NOISE_SCALE * self.data.value_scale)

    @property
    def _normalised(self) -> Array:
        """Values of mean zero and about unit variance; shape (N,)."""
        return (self.values - self.values.mean()) / self._spread

    def _values_and_gradients(self, point: ArrayLike) -> tuple[Array, Array]:
        """Value of each network (networks, …) and its gradient (networks, …, d)."""
        scaled = self.data.scaled(point)
        found = [network.value_and_gradient(scaled) for network in self._networks]
        values, gradients = (np.stack(parts) for parts in zip(*found, strict=True))
        missing = np.where(np.isfinite(scaled).all(axis=-1), 0.0, np.nan)
        return (
            self.values.mean() + self._spread * values + missing,
            self._spread * gradients / self.data.scale + missing[..., None],
        )


def _trained(points: Array, values: Array, seed: int) -> Network:
    """Trains a network on a bootstrap sample of scaled points (N, d) and normalised values (N,)."""
    from sklearn.neural_network import MLPRegressor

    count = len(values)
    sample = np.random.default_rng(seed).integers(0, count, count)
    network = MLPRegressor(
        hidden_layer_sizes=HIDDEN_UNITS,
        activation="tanh",
        solver="lbfgs",
        alpha=DECAY,
        max_iter=MOST_ITERATIONS,
        random_state=seed,
    )
    with catch_warnings(), one_blas_thread():
        simplefilter("ignore")  # the number of iterations is meant as a limit
        network.fit(points[sample], values[sample])
    unseen = np.ones(count, bool)
    unseen[sample] = False
    layers = (Layer(*layer) for layer in zip(network.coefs_, network.intercepts_, strict=True))
    return Network(tuple(layers), unseen)


def _fit(data: TrainingData) -> Ensemble:
    return Ensemble(data)


def _from_dict(saved: Mapping[str, Any]) -> Ensemble:
    return Ensemble(TrainingData.from_dict(saved))


ENSEMBLE = ResidualModel("ensemble", "an ensemble of neural networks", _fit, _from_dict)
"""The residual `ensemble`; it is not installed, so no run can select it."""


def ensemble(trial: Trial) -> Sequence[Steps]:
    """A redeployment with the ensemble as the residual, with everything else of the default learner."""
    learner = trial.learner(trial.nominal, trial.first, LearningSettings(residual="constant"), 1)
    residual = fit_residual(ENSEMBLE, observe(trial.first, trial.nominal))
    return [trial.first, trial.measure(replace(learner, residual=residual), 1)]
