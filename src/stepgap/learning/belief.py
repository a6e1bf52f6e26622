"""A belief: what a robot's error is taken to be, from one point of view on what happened to the robot.

The error of each state coordinate is a weighted sum of features plus noise. The weights are normal; the variance of the
noise has the distribution of a mean of squares, of as many values as are known of it (scaled inverse χ²; Gelman et al.,
Bayesian Data Analysis, Sec. 3.2). So an error has Student's t distribution about its mean.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal, final

from stepgap.gauss.student import log_student
from stepgap.gauss.weights import Weights
from stepgap.step import Array

Kind = Literal["family", "unknown", "nominal", "fitted", "run", "changed", "current", "earlier"]
"""Where a belief began: with a prior over robots, with a robot of which nothing is known, with a nominal map that is
right, with a fitted residual that is right, with an earlier run, or with a change just before a step. `current` is what
is believed since a change was reported, `earlier` what was believed before it."""


@final
@dataclass(frozen=True, eq=False)
class Belief:
    """A belief about n state coordinates; immutable. All numbers are in half ranges.

    Attributes:
        kind: Where it began.
        weights: Of the k features.
        freedom: Degrees of freedom of the noise of each coordinate; more than 2; shape (n,).
        squares: Sum of squares of that noise; shape (n,).
        log_weight: Logarithm of its probability, up to a number that all beliefs share.
        rate: Standard deviation of the random walk of its constant and periodic part in a step, in those of the noise.
        age: Number of steps since it began.
    """

    kind: Kind
    weights: Weights
    freedom: Array
    squares: Array
    log_weight: float
    rate: float = 0.0
    age: int = 0

    @property
    def noise(self) -> Array:
        """Expected variance of the noise; shape (n,)."""
        return self.squares / (self.freedom - 2)

    def walked(self, places: Sequence[int]) -> "Belief":
        """The belief before the next step, by the random walk of the weights at some places."""
        return replace(self, weights=self.weights.walked(places, self.rate**2 * self.noise)) if self.rate else self

    def log_density(self, error: Array, variance: Array) -> float:
        """Logarithm of the density of differences (n,) from the mean whose expected squares are `variance`."""
        freedom = float(self.freedom.min())
        return log_student(error, variance * (freedom - 2) / freedom, freedom)

    def learned(self, features: Array, error: Array, trust: float) -> "Belief":
        """The belief after a step.

        Args:
            features: Of the step; shape (k,).
            error: Of the nominal map; shape (n,).
            trust: How much the step counts, from 0 to 1: the probability that nothing disturbed it.
        """
        mean, variance = self.weights.predicted(features)
        noise = self.noise
        total = variance + noise / trust
        return replace(
            self,
            weights=self.weights.learned(features, error, noise / trust),
            freedom=self.freedom + trust,
            squares=self.squares + noise * (error - mean) ** 2 / total,
            age=self.age + 1,
        )
