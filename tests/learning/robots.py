"""Robots in half ranges of two states and two commands, whose errors are polynomials, for tests of beliefs."""

import numpy as np
from numpy.typing import ArrayLike

from stepgap.gauss.features import Features
from stepgap.gauss.monomials import monomials
from stepgap.learning.beliefs import Beliefs, Observed
from stepgap.learning.first_beliefs import Family
from stepgap.step import Array

SIZES = 2, 2
FEATURES = Features.drawn(4, 2, 3, 2.0, np.random.default_rng(0))
NOMINAL = np.array([[0.5, 0.1, 0.8, 0.0], [0.0, 0.3, 0.0, 0.8]])
NOISE = 0.03
STDS = np.concatenate([[0.15], np.full(4, 0.12), np.full(10, 0.05)])
"""Standard deviations of the weights of constant, slopes and squares."""
POINTS = np.random.default_rng(9).uniform(-0.8, 0.8, (40, 4))

FAMILY = Family(np.zeros((2, 15)), np.tile(np.diag(STDS**2), (2, 1, 1)), np.full(2, NOISE))
"""From it `drawn` draws robots."""


def drawn(seed: int) -> Array:
    """Weights of a robot of the family; shape (2, 15)."""
    return STDS * np.random.default_rng([seed, 1]).standard_normal((2, 15))


def changed(weights: Array, constant: ArrayLike = (0.25, -0.15)) -> Array:
    """Weights of the robot with another constant."""
    return weights + np.outer(np.asarray(constant), np.eye(15)[0])


class Robot:
    """A robot that makes steps by random commands; its attributes may be changed between them.

    Attributes:
        weights: Of its error; shape (2, 15).
        late: Effect of the command of the step before.
        state: True state.
        measured: Measured one.
    """

    def __init__(self, weights: Array, seed: int = 0):
        self.weights, self.late = weights, 0.0
        self.rng = np.random.default_rng([seed, 2])
        self.state, self.measured, self._last = np.zeros(2), np.zeros(2), np.zeros(2)

    def step(
        self,
        command: Array | None = None,
        phase: float = np.nan,
        push: ArrayLike = (0.0, 0.0),
        glitch: ArrayLike = (0.0, 0.0),
    ) -> Observed:
        """Makes a step, which a push may disturb, and whose end may be measured wrongly."""
        if command is None:
            command = self.rng.uniform(-1, 1, 2)
        point = np.concatenate([self.state, command])
        after = NOMINAL @ point + self.weights @ monomials(point, 2) + self.late * self._last
        after = after + NOISE * self.rng.standard_normal(2) + np.asarray(push)
        seen, measured = np.concatenate([self.measured, command]), after + np.asarray(glitch)
        self.state, self.measured, self._last = after, measured, command

        def from_elsewhere(offset: Array) -> tuple[Array, Array, Array]:
            moved = seen - np.concatenate([offset, np.zeros(2)])
            return moved, measured - NOMINAL @ moved, NOMINAL[:, :2]

        return Observed(seen, measured - NOMINAL @ seen, phase, command=command, from_elsewhere=from_elsewhere)

    def error(self, points: Array = POINTS) -> Array:
        """Expected error at points (…, 4); shape (…, 2)."""
        return monomials(points, 2) @ self.weights.T


def begun(*families: Family) -> Beliefs:
    """Beliefs before the first step of a robot."""
    return Beliefs.start(FEATURES, SIZES, families, None)


def known(beliefs: Beliefs, points: Array = POINTS) -> tuple[Array, Array]:
    """Mean and standard deviation of the error that plans have at points (…, 4); shapes (…, 2)."""
    mixture, features, count = beliefs.mixture(np.nan), FEATURES(points), FEATURES.count
    covariance = mixture.covariance[:, :count, :count]
    variance = np.einsum("...a,nab,...b->...n", features, covariance, features)
    return features @ mixture.mean[:, :count].T, np.sqrt(variance)


def rms(beliefs: Beliefs, robot: Robot) -> float:
    """Root mean square of what the beliefs take the error for, less what it is."""
    return float(np.sqrt(np.mean((known(beliefs)[0] - robot.error()) ** 2)))


def kinds(beliefs: Beliefs) -> list[str]:
    return [each.kind for each in beliefs.beliefs]
