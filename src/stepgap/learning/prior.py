"""A prior over robots: what the errors of a nominal map have in common on many robots of a kind.

The error of each state coordinate is a quadratic polynomial of the scaled state and command, whose weights are drawn
for each robot from one normal distribution. `fit_prior` finds that distribution from the steps of many robots, by
expectation maximisation (Gelman et al., Bayesian Data Analysis, Sec. 15.5). The noise is that of each robot, so that a
bad one has little weight.

With this prior some three steps of a new robot say as much as ten without it. A belief that the robot is of that kind
competes with beliefs that it is not, and loses if it predicts worse.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from stepgap.gauss.features import Features
from stepgap.gauss.monomials import monomials, number_of_monomials
from stepgap.learning.first_beliefs import Family, unknown
from stepgap.learning.observations import Observations
from stepgap.step import Array, StepSpace

DEGREE = 2  # Degree of the polynomials
LEAST_FOR_PRIOR = 5  # Number of robots from which a prior can be found

_ROUNDS = 60
"""Number of rounds of expectation maximisation; later ones change no weight by more than a hundredth of its spread."""

LEAST_SPREAD = 1e-4
"""Variance of a weight that a single robot is taken to add [half ranges²], so that no direction is without spread."""


class CoordinatePrior(NamedTuple):
    """Prior of the error of one state coordinate, in half ranges.

    Attributes:
        mean: Mean of the weights of the monomials; shape (k,).
        covariance: Their covariance between robots; shape (k, k).
        noise_std: Standard deviation of a step's error about the polynomial, median of the robots.
    """

    mean: Array
    covariance: Array
    noise_std: float


@final
@dataclass(frozen=True, eq=False)
class Prior:
    """A prior over robots.

    Attributes:
        names: Names of the d coordinates of state and command.
        centre: Middle of the range of use of each; shape (d,).
        scale: Half that range; shape (d,).
        coordinates: Of each of the n state coordinates.
    """

    names: tuple[str, ...]
    centre: Array
    scale: Array
    coordinates: tuple[CoordinatePrior, ...]

    def family(self, space: StepSpace, features: Features) -> Family:
        """The prior for beliefs about a robot with these ranges, in half ranges.

        Args:
            space: Ranges of state and command, which may differ from those of the prior.
            features: Of state, command and context inputs, on which robots of the family do not depend.
        """
        d = len(self.names)
        n = len(space.state)
        centre = np.concatenate([space.state_centre, space.command_centre])
        back = self._converted(centre, np.concatenate([space.state_scale, space.command_scale]))
        size = number_of_monomials(d, features.degree)
        kept = _kept(d, features.inputs)[:size]
        of_robot = unknown(features, n)
        for row, coordinate in enumerate(self.coordinates):
            unit = self.scale[row] / space.state_scale[row]
            covariance = unit**2 * (back @ coordinate.covariance @ back.T)[:size, :size]
            of_robot.mean[row, kept] = unit * (coordinate.mean @ back.T)[:size]
            of_robot.covariance[row][np.ix_(kept, kept)] = (covariance + covariance.T) / 2
            of_robot.noise_std[row] = unit * coordinate.noise_std
        return of_robot

    def _converted(self, centre: Array, scale: Array) -> Array:
        """The matrix that converts weights of this prior to those of inputs with other ranges; shape (k, k)."""
        d = len(self.names)
        x = np.random.default_rng(0).uniform(-1, 1, (4 * (d + 1) ** 2, d))
        there = monomials((x * self.scale + self.centre - centre) / scale, DEGREE)
        return np.asarray(np.linalg.lstsq(there, monomials(x, DEGREE))[0], float)


def _kept(d: int, size: int) -> NDArray[np.intp]:
    """Which monomials of `size` inputs have the first d alone; in the order of the monomials of those d."""
    first, second = np.triu_indices(size)
    pairs = 1 + size + np.flatnonzero((first < d) & (second < d))
    return np.concatenate([np.arange(1 + d), pairs])


def fit_prior(robots: Sequence[Observations]) -> Prior:
    """Finds the prior from the observations of many robots.

    Raises:
        ValueError: There are too few robots.
    """
    if len(robots) < LEAST_FOR_PRIOR:
        raise ValueError(f"{len(robots)} robots, but a prior needs those of at least {LEAST_FOR_PRIOR}")
    space = robots[0].space
    basis = [monomials(space.scaled_inputs(robot.state, robot.command), DEGREE) for robot in robots]
    errors = [robot.error / space.state_scale for robot in robots]
    coordinates = [_fitted(basis, [error[:, number] for error in errors]) for number in range(len(space.state))]
    centre = np.concatenate([space.state_centre, space.command_centre])
    scale = np.concatenate([space.state_scale, space.command_scale])
    return Prior(space.names, centre, scale, tuple(coordinates))


def _fitted(basis: Sequence[Array], values: Sequence[Array]) -> CoordinatePrior:
    """Expectation maximisation for one coordinate: monomials (N, k) and errors (N,) of each robot [half ranges]."""
    size = basis[0].shape[1]
    count = len(basis)
    mean = np.zeros(size)
    covariance = 0.1 * np.eye(size)
    noise = np.full(count, 0.05**2)
    grams = [rows.T @ rows for rows in basis]
    sums = [rows.T @ value for rows, value in zip(basis, values, strict=True)]
    for _ in range(_ROUNDS):
        prior = np.linalg.inv(covariance)
        spreads = [np.linalg.inv(prior + gram / one) for gram, one in zip(grams, noise, strict=True)]
        weights = np.array(
            [spread @ (prior @ mean + total / one) for spread, total, one in zip(spreads, sums, noise, strict=True)]
        )
        for number, (rows, value) in enumerate(zip(basis, values, strict=True)):
            squares = float(np.sum((value - rows @ weights[number]) ** 2) + np.sum(grams[number] * spreads[number]))
            noise[number] = squares / len(value)
        mean = weights.mean(axis=0)
        covariance = ((weights - mean).T @ (weights - mean) + sum(spreads) + LEAST_SPREAD * np.eye(size)) / count
    return CoordinatePrior(mean, covariance, float(np.sqrt(np.median(noise))))
