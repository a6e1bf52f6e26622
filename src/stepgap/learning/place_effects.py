"""What of recorded errors belongs to the place and not to the step: taken out before a residual is learnt from them.

A leaning boom or floor shifts the next state by a sin ψ + b cos ψ at place ψ, with a and b of each deployment, since
the zero of ψ is arbitrary. On one stair of a reference all steps of a deployment are near one place, so that a residual
would learn its shift as if it belonged to the states and commands of that stair. The shifts are estimated beside a
quadratic of state and command and a constant of each deployment, by Bayesian linear regression (Gelman et al., Bayesian
Data Analysis, Sec. 14.8), and each coordinate takes the strength of them that is likeliest; where nothing clearly
depends on the place, that is none.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT, PRIOR_STD, monomials
from stepgap.step import Array

STRENGTHS = (0.0, 0.5, 1.0, 2.0, 4.0)
"""A priori standard deviations of a and b, in those of a step's noise, among which the likeliest is chosen."""

RELUCTANCE = 5.0
"""Log evidence by which one of them must be likelier than none."""

CONSTANT = 1.0
"""A priori standard deviation of a deployment's constant, in those of a step's noise."""


@dataclass(frozen=True, eq=False)
class _Part:
    """One deployment's steps.

    Attributes:
        smooth: Monomials of state and command; shape (k, p).
        waves: 1, sin ψ and cos ψ, the latter two zero where the place is not known; shape (k, 3).
        error: Shape (k, n).
    """

    smooth: Array
    waves: Array
    error: Array

    def coefficients(self, values: Array, strength: float) -> Array:
        """Of waves of such a strength, beside noise, in columns (k, c); shape (3, c)."""
        scale = _scale(strength)
        return scale @ np.linalg.solve(self._precision(scale), scale @ self.waves.T @ values)

    def explained(self, values: Array, strength: float) -> Array:
        """What of columns (k, c) constant and waves explain; shape (k, c)."""
        return self.waves @ self.coefficients(values, strength)

    def spread(self, strength: float) -> float:
        """Log determinant of the covariance of noise, constant and waves, in variances of the noise."""
        return float(np.linalg.slogdet(self._precision(_scale(strength)))[1])

    def _precision(self, scale: Array) -> Array:
        return np.eye(3) + scale @ self.waves.T @ self.waves @ scale


def without_place_effects(observations: Observations, present: int) -> Observations:
    """The observations, their errors less what the place added to them; as they are where no place is known.

    Args:
        observations: Of one or more deployments.
        present: Number of a deployment that goes on, whose errors stay as they are: the first hops on a round are too
            few to tell a place from a constant, and `drift` follows both.
    """
    space, deployment = observations.space, observations.deployment
    if observations.place is None or deployment is None:
        return observations
    place = np.where(deployment < present, observations.place, np.nan)
    if not np.isfinite(place).any():
        return observations
    state, command = (observations.state - space.state_centre) / space.state_scale, observations.applied_command
    smooth = monomials(np.hstack([state, space.point_of(command)]), 2)
    waves = np.nan_to_num(np.column_stack([np.ones(len(place)), np.sin(place), np.cos(place)]))
    groups = [np.flatnonzero(deployment == number) for number in np.unique(deployment)]
    parts = [_Part(smooth[rows], waves[rows], observations.error[rows]) for rows in groups]
    found = [_estimated(parts, strength, NOISE_SCALE * space.state_scale) for strength in STRENGTHS]
    handicap = np.where(np.array(STRENGTHS) > 0, RELUCTANCE, 0.0)[:, None]
    likeliest = np.argmax(np.array([evidence for evidence, _ in found]) - handicap, axis=0)
    effects = np.array([effect for _, effect in found])[likeliest, :, np.arange(len(likeliest))].T
    error = observations.error.copy()
    error[np.concatenate(groups)] -= effects
    return replace(observations, error=error)


def _scale(strength: float) -> Array:
    return np.diag([CONSTANT, strength, strength])


def _estimated(parts: Sequence[_Part], strength: float, noise_scale: Array) -> tuple[Array, Array]:
    """Log evidence for waves of a strength, up to a constant, shape (n,), and what they add, part by part; (N, n)."""
    size, steps = parts[0].smooth.shape[1], sum(len(part.error) for part in parts)
    information, projection = np.eye(size) / PRIOR_STD**2, np.zeros((size, len(noise_scale)))
    squares, spread = PRIOR_COUNT * noise_scale**2, 0.0
    for part in parts:
        smooth, error = part.smooth, part.error
        information = information + smooth.T @ (smooth - part.explained(smooth, strength))
        left = error - part.explained(error, strength)
        projection, squares = projection + smooth.T @ left, squares + np.sum(error * left, axis=0)
        spread += part.spread(strength)
    weights = np.linalg.solve(information, projection)
    left = squares - np.sum(projection * weights, axis=0)
    evidence = -0.5 * ((PRIOR_COUNT + steps) * np.log(left) + spread + np.linalg.slogdet(information)[1])
    rest = [(part.waves[:, 1:], part.coefficients(part.error - part.smooth @ weights, strength)[1:]) for part in parts]
    return evidence, np.vstack([waves @ coefficients for waves, coefficients in rest])
