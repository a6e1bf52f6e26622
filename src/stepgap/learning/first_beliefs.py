"""The beliefs before the first step of a robot: of families of robots, of unknown ones, and that a map is right.

`docs/learning.md` has their table, and says by which measurement each number here was chosen.
"""

from collections.abc import Sequence
from math import log
from typing import Final, NamedTuple

import numpy as np

from stepgap.gauss.features import Features
from stepgap.gauss.monomials import number_of_monomials
from stepgap.gauss.weights import Weights
from stepgap.learning.belief import Belief, Kind
from stepgap.step import Array

RATES: Final = (0.0, 0.1)
"""Random walk of constant and periodic part in a step, of two beliefs that are otherwise equal [noise deviations]."""
PERIODIC_STD: Final = 0.3  # Prior standard deviation of the periodic part [noise deviations]
ERROR_BEFORE_STD = 0.05
COMMAND_BEFORE_STD = 0.03
"""Prior standard deviations of the weights of the step before: of its error, and of its command [half ranges]."""
LAGGED_COMMAND_STD: Final = 0.2
"""The same of the command before, of robots on which it acts beyond its step. With 0.03, what it does was taken for an
effect of the error before, which plans of later steps do not count, so that their commands grew; with 0.3, a policy
that stands at slow commands was told too much there."""
WAVE_STD: Final = 0.06  # Prior standard deviation of the part that no quadratic has [half ranges]
UNKNOWN_STDS: Final = ((0.3, 0.08), (0.6, 0.6))
"""Prior standard deviations of the weights of robots of which nothing is known: up to degree 1, and of degree 2."""
LAGGED_STDS: Final = ((0.3, 0.08), (0.3, 0.04))
"""The same of robots that follow their commands with a lag, such as commanded velocities. With 0.6, a humanoid that had
walked forward was told to turn to the wrong side on its way back: its quadratic had a second root there."""
UNKNOWN_NOISE = 0.03
NOMINAL_NOISE = 0.1
"""Expected standard deviation of their noise, and of that of a nominal map that is right [half ranges]."""
RIGHT_STD: Final = 1e-3  # Prior standard deviation of the weights where a map is right [half ranges]
EXPECTED_NOISE_COUNT: Final = 8.0  # Number of steps that an expected noise is worth
RIVAL: Final = 0.02  # Probability of each rival of what is expected of a robot, before its first step
MOST_MONOMIALS: Final = 150
"""With more monomials of degree 2 beliefs are about degree 1: no deployment tells so many weights apart."""
WAVES = 30
WAVE_LENGTH = 1.0
LEAST_FOR_WAVES = 100
"""Number and length scale [half ranges] of the waves among the features, and number of steps that must be known before
a deployment for it to have them: with fewer they only make the map less sure where the robot has not been."""


class Family(NamedTuple):
    """What robots of a kind have in common: distributions of the weights of the monomials, in half ranges.

    Attributes:
        mean: Shape (n, d_φ).
        covariance: Shape (n, d_φ, d_φ).
        noise_std: Of a step's error; shape (n,).
    """

    mean: Array
    covariance: Array
    noise_std: Array


def first_beliefs(
    features: Features, sizes: tuple[int, int], families: Sequence[Family], fitted: Array | None, lagged: bool = False
) -> tuple[Belief, ...]:
    """Returns the beliefs before the first step of a robot, those of what is expected of it first.

    Args:
        features: Of state, command and context inputs.
        sizes: Number of state coordinates n and of command coordinates m.
        families: Priors over robots, equally probable ones.
        fitted: Noise of a fitted residual, whose remaining error is believed about; shape (n,) [half ranges].
        lagged: Whether the command of the step before may act as much as that of the step.
    """
    n, _ = sizes
    zero = np.zeros((n, features.monomials))
    right = np.tile(RIGHT_STD**2 * np.eye(features.monomials), (n, 1, 1))
    expected: list[tuple[Kind, Family]] = [("family", family) for family in families]
    if fitted is not None:
        expected = [("fitted", Family(zero, right, fitted))]
    unknown_stds = LAGGED_STDS if lagged else UNKNOWN_STDS
    rivals: list[tuple[Kind, Family]] = [("unknown", unknown(features, n, stds)) for stds in unknown_stds]
    nominal: list[tuple[Kind, Family]] = [("nominal", Family(zero, right, np.full(n, NOMINAL_NOISE)))]
    groups = [(1 - 2 * RIVAL, expected), (2 * RIVAL, rivals)] if expected else [(1 - 2 * RIVAL, rivals)]
    if fitted is None:
        groups.append((RIVAL, nominal))
    return tuple(
        _belief(kind, family, log(share / len(group) / len(RATES)), rate, features, sizes, lagged)
        for share, group in groups
        for kind, family in group
        for rate in RATES
    )


def features_of(inputs: int, steps: int) -> Features:
    """Features of beliefs about errors that depend on a number of inputs, before a deployment with `steps` known."""
    degree = 2 if number_of_monomials(inputs, 2) <= MOST_MONOMIALS else 1
    waves = WAVES if steps >= LEAST_FOR_WAVES else 0
    return Features.drawn(inputs, degree, waves, WAVE_LENGTH, np.random.default_rng(0))


def unknown_belief(features: Features) -> Belief:
    """A belief about one coordinate of a robot of which nothing is known, without what was before a step."""
    family = unknown(features, 1)
    size = features.count
    covariance = WAVE_STD**2 * np.eye(size)[None]
    covariance[:, : features.monomials, : features.monomials] = family.covariance
    freedom = np.full(1, EXPECTED_NOISE_COUNT)
    weights = Weights(np.zeros((1, size)), np.sqrt(covariance))
    return Belief("unknown", weights, freedom, (freedom - 2) * family.noise_std**2, 0.0)


def unknown(features: Features, coordinates: int, stds: tuple[float, float] = UNKNOWN_STDS[0]) -> Family:
    """The weights of robots of which nothing is known, with standard deviations up to degree 1 and of degree 2."""
    linear = np.arange(features.monomials) <= features.inputs
    covariance = np.diag(np.where(linear, *stds) ** 2)
    zero = np.zeros((coordinates, features.monomials))
    return Family(zero, np.tile(covariance, (coordinates, 1, 1)), np.full(coordinates, UNKNOWN_NOISE))


def _belief(
    kind: Kind, family: Family, log_weight: float, rate: float, features: Features, sizes: tuple[int, int], lagged: bool
) -> Belief:
    n, m = sizes
    command_std = LAGGED_COMMAND_STD if lagged else COMMAND_BEFORE_STD
    count = features.monomials
    size = features.count + 2 + n + m
    mean = np.zeros((n, size))
    covariance = np.zeros((n, size, size))
    mean[:, :count] = family.mean
    covariance[:, :count, :count] = family.covariance
    for coordinate, noise in enumerate(family.noise_std):
        parts = [(features.waves, WAVE_STD), (2, PERIODIC_STD * noise), (n, ERROR_BEFORE_STD), (m, command_std)]
        stds = np.concatenate([np.full(number, std) for number, std in parts])
        covariance[coordinate, range(count, size), range(count, size)] = stds**2
    freedom = np.full(n, EXPECTED_NOISE_COUNT)
    weights = Weights.of_moments(mean, covariance)
    return Belief(kind, weights, freedom, (freedom - 2) * family.noise_std**2, log_weight, rate)
