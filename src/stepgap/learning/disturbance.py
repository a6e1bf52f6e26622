"""The disturbance: the part of a step's error that depends on deployment and phase, not on state and command.

A tilted boom or floor, a motor that warms up or a slack cable shift the next state. For each coordinate the shift is

    d(ψ) = c₀ + c₁ sin ψ + c₂ cos ψ        with c ~ N(0, σ² diag(1, s², s²)) a priori

at phase ψ, where σ is the standard deviation of a step's noise and s the strength of the periodic part, zero where this
part is omitted. ψ is the phase of the quantity of the robot's context that has a period (`StepSpace.periodic`), such as
the yaw of a robot on a boom, when the step starts; where there is none, c₀ alone remains. The zero of ψ is arbitrary,
so every deployment has its own c, and c may change within it.

- `DisturbanceFilter` estimates c while a deployment is running. It is a bank of Kalman filters, some with s = 0 and
  some with s = 1, each with a random walk of another rate. The filter with the best recent predictions is used, or
  none of them, so that nothing is added where nothing drifts. A coefficient that is not observed for a long time is
  forgotten, but its variance does not exceed the initial one (Kulhavý's stabilised forgetting).
- `without_periodic_part` removes c₁ sin ψ + c₂ cos ψ from the errors of earlier deployments before a residual is fitted
  to them. A deployment reaches each target near one phase, so the residual would mistake the disturbance for an effect
  of the states and commands there. c is estimated together with a quadratic of state and command by Bayesian
  linear regression (Gelman et al., Bayesian Data Analysis, Sec. 14.8), with the s of the highest evidence; without
  clear evidence for any s, nothing is removed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Self, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT, PRIOR_STD, monomials
from stepgap.step import Array

RATES = np.array([0.02, 0.05, 0.1, 0.2, 0.4])
"""Standard deviations of a coefficient's change in a step, one for each filter, relative to the initial one."""
FILTER_STRENGTHS = (0.0, 1.0)
"""Strengths s of the filters; there is one filter for each pair of strength and rate."""
SCORE_MEMORY = 0.98
"""Factor of a filter's score from one step to the next: about the last 50 steps count."""
SWITCHING_PENALTY = 5.0
"""A filter is used when its score is better than that of no filter by this number of mean squared errors, or of
predicted variances where these are smaller: a constant error of many standard deviations is followed at once."""
CHANGE_STD = 20.0
"""Prior standard deviation of the constant by which a robot changes, in standard deviations of a step's noise."""
SLOPE_STD = 8.0
"""Prior standard deviation of what a change adds per half range of each state and command coordinate, likewise."""

STRENGTHS = (0.0, 0.5, 1.0, 2.0, 4.0)
"""Strengths s among which the regression chooses."""
LEAST_EVIDENCE = 5.0
"""Difference of the log evidence by which a strength must exceed the strength zero."""


def regressors(phase: ArrayLike) -> Array:
    """Regressors 1, sin ψ and cos ψ; the latter two are zero where the phase is unknown (NaN); (…) [rad] to (…, 3)."""
    phase = np.asarray(phase, float)
    return np.nan_to_num(np.stack([np.ones(phase.shape), np.sin(phase), np.cos(phase)], axis=-1))


def prior_std(strength: float) -> Array:
    """Prior standard deviations of the coefficients, in standard deviations of a step's noise; shape (3,)."""
    return np.array([1.0, strength, strength])


FORGETTING = np.tile(RATES**2, len(FILTER_STRENGTHS))
"""Fraction by which each filter's covariance returns to the prior one in a step; shape (filters,)."""


@final
@dataclass(frozen=True, eq=False)
class Disturbance:
    """The disturbance of the next step, which is constant, or after a change of the robot linear in state and command.

    Attributes:
        constant: Shape (n,) [units of the state].
        slopes: Per half range of each state and command coordinate; shape (n, n + m) [units of the state].
        covariance: Of constant and slopes, for each state coordinate; shape (n, 1 + n + m, 1 + n + m).
    """

    constant: Array
    slopes: Array
    covariance: Array

    def removed(self) -> "Disturbance":
        """No disturbance, of the same sizes."""
        return Disturbance(0 * self.constant, 0 * self.slopes, 0 * self.covariance)

    @property
    def is_zero(self) -> bool:
        """Whether it is known that there is none."""
        return not (self.constant.any() or self.slopes.any() or self.covariance.any())

    def mean(self, inputs: Array) -> Array:
        """Expected disturbance at states and commands in half ranges; (…, n + m) to (…, n) [units of the state]."""
        return self.constant + inputs @ self.slopes.T

    def std(self, inputs: Array) -> Array:
        """Standard deviation of the disturbance; (…, n + m) to (…, n) [units of the state]."""
        rows = _with_one(inputs)
        return np.sqrt(np.einsum("...a,nab,...b->...n", rows, self.covariance, rows))

    def std_gradient(self, inputs: Array) -> Array:
        """∂std/∂inputs; (…, n + m) to (…, n, n + m) [units of the state per half range]."""
        product = np.einsum("nab,...b->...na", self.covariance, _with_one(inputs))[..., 1:]
        std = self.std(inputs)[..., None]
        return np.divide(product, std, out=np.zeros_like(product), where=std > 0)


def _with_one(inputs: Array) -> Array:
    return np.concatenate([np.ones((*inputs.shape[:-1], 1)), inputs], axis=-1)


@final
@dataclass(frozen=True, eq=False)
class DisturbanceFilter:
    """Estimate of the disturbance within a deployment; immutable.

    Its q = 3 + n + m regressors are those of the phase, then state and command in half ranges, whose coefficients are
    zero until the robot changes.

    Attributes:
        coefficients: c of each filter; shape (filters, q, n).
        covariance: Covariance of c, in variances of a step's noise; shape (filters, q, q).
        prior: Covariance of c a priori; shape (filters, q, q).
        scores: Discounted sums of squared innovations without a filter, then of each filter, in predicted variances;
            shape (1 + filters, n).
        weight: Discounted number of steps.
    """

    coefficients: Array
    covariance: Array
    prior: Array
    scores: Array
    weight: float = 0.0

    @classmethod
    def initial(cls, size: int, inputs: int = 0) -> Self:
        """Returns the estimate before the first step, for n state coordinates and n + m inputs."""
        stds = [np.append(prior_std(strength), np.zeros(inputs)) for strength in FILTER_STRENGTHS for _ in RATES]
        prior = np.array([np.diag(std**2) for std in stds])
        return cls(np.zeros((len(prior), 3 + inputs, size)), prior, prior, np.zeros((1 + len(prior), size)))

    @property
    def changed(self) -> bool:
        """Whether it estimates how the robot has changed."""
        return bool(np.isinf(self.scores[0]).all())

    def predict(self, phase: float, noise_std: ArrayLike = 1.0) -> Disturbance:
        """Returns the disturbance of the next step.

        Args:
            phase: Phase at which the step starts [rad], NaN if it is unknown.
            noise_std: Standard deviation of a step's noise; shape (n,), or one for all.
        """
        of_phase, best, size = regressors(phase), self._best, self.scores.shape[1]
        inputs = self.coefficients.shape[1] - 3
        rows = np.zeros((1 + inputs, 3 + inputs))
        rows[0, :3], rows[1:, 3:] = of_phase, np.eye(inputs)
        unused = np.zeros((1, 3 + inputs, size))
        coefficients = rows @ np.concatenate([unused, self.coefficients])[best, :, np.arange(size)].T
        covariance = np.concatenate([0 * self.prior[:1], self._predicted_covariance()])[best]
        variance = np.broadcast_to(np.square(noise_std), size)[:, None, None]
        return Disturbance(coefficients[0], coefficients[1:].T, variance * (rows @ covariance @ rows.T))

    def restarted(self) -> "DisturbanceFilter":
        """Returns the estimate if the robot changes: a linear function is added, which no filter may leave out."""
        scores = np.zeros_like(self.scores)
        scores[0] = np.inf
        inputs = self.prior.shape[-1] - 3
        wide = np.diag([CHANGE_STD**2, 0.0, 0.0, *[SLOPE_STD**2] * inputs])
        prior = self.prior.copy()
        prior[:, 3:, 3:] = SLOPE_STD**2 * np.eye(inputs)
        return DisturbanceFilter(self.coefficients, self.covariance + wide, prior, scores)

    def updated(
        self, error: Array, phase: float, std: ArrayLike = 1.0, inputs: ArrayLike | None = None
    ) -> "DisturbanceFilter":
        """Returns the estimate after a step.

        Args:
            error: Error of the map without the disturbance; shape (n,).
            phase: Phase at which the step started [rad], NaN if it is unknown.
            std: Standard deviation of that error as it was predicted, with noise; shape (n,), or one for all.
            inputs: State and command in half ranges, shape (n + m,); None if there are none.
        """
        row, covariance = np.append(regressors(phase), [] if inputs is None else inputs), self._predicted_covariance()
        predicted = np.einsum("k,fkn->fn", row, self.coefficients)
        innovation = error - np.vstack([np.zeros((1, predicted.shape[1])), predicted])
        cross = covariance @ row
        gain = cross / (cross @ row + 1.0)[:, None]
        return replace(
            self,
            coefficients=self.coefficients + gain[:, :, None] * innovation[1:, None, :],
            covariance=covariance - gain[:, :, None] * cross[:, None, :],
            scores=SCORE_MEMORY * self.scores + (innovation / np.asarray(std)) ** 2,
            weight=SCORE_MEMORY * self.weight + 1.0,
        )

    @property
    def _best(self) -> NDArray[np.intp]:
        """Index of the filter in use, 0 for none; shape (n,)."""
        mean_square = np.minimum(self.scores[0] / max(self.weight, 1.0), 1.0)
        penalty = np.where(np.arange(len(self.scores)) > 0, SWITCHING_PENALTY, 0.0)[:, None] * mean_square
        return np.argmin(self.scores + penalty, axis=0)

    def _predicted_covariance(self) -> Array:
        """Covariances one step later, before its error is known; shape (filters, q, q)."""
        return self.covariance + FORGETTING[:, None, None] * (self.prior - self.covariance)


def without_periodic_part(observations: Observations, iteration: int) -> Observations:
    """Removes the periodic part of the disturbance from the errors of observations.

    Args:
        observations: Observations of one or more deployments. If no phase is known, they are returned unchanged.
        iteration: Number of the running deployment, from whose errors nothing is removed: in the first steps of a
            turn sine and cosine cannot be distinguished from a constant, and `DisturbanceFilter` estimates all three.
    """
    space, deployment = observations.space, observations.deployment
    if observations.phase is None or deployment is None:
        return observations
    phase = np.where(deployment < iteration, observations.phase, np.nan)
    if not np.isfinite(phase).any():
        return observations
    points = space.scaled_inputs(observations.state, observations.command)
    features, rows = monomials(points, 2), regressors(phase)
    groups = [np.flatnonzero(deployment == number) for number in np.unique(deployment)]
    parts = [_Part(features[group], rows[group], observations.error[group]) for group in groups]
    estimates = [_estimate(parts, strength, NOISE_SCALE * space.state_scale) for strength in STRENGTHS]
    penalty = np.where(np.array(STRENGTHS) > 0, LEAST_EVIDENCE, 0.0)[:, None]
    likeliest = np.argmax(np.array([evidence for evidence, _ in estimates]) - penalty, axis=0)
    disturbance = np.array([found for _, found in estimates])[likeliest, :, np.arange(len(likeliest))].T
    error = observations.error.copy()
    error[np.concatenate(groups)] -= disturbance
    return replace(observations, error=error)


@dataclass(frozen=True, eq=False)
class _Part:
    """One deployment's steps.

    Attributes:
        features: Monomials of state and command; shape (k, p).
        regressors: Regressors of the disturbance; shape (k, 3).
        error: Shape (k, n).
    """

    features: Array
    regressors: Array
    error: Array

    def coefficients(self, values: Array, strength: float) -> Array:
        """Posterior means of c from columns (k, j) that consist of disturbance and noise only; shape (3, j)."""
        scale = np.diag(prior_std(strength))
        return scale @ np.linalg.solve(self._precision(scale), scale @ self.regressors.T @ values)

    def disturbance(self, values: Array, strength: float) -> Array:
        """The disturbance in columns (k, j) that consist of disturbance and noise only; shape (k, j)."""
        return self.regressors @ self.coefficients(values, strength)

    def log_determinant(self, strength: float) -> float:
        """Log determinant of the covariance of noise and disturbance, in variances of the noise."""
        return float(np.linalg.slogdet(self._precision(np.diag(prior_std(strength))))[1])

    def _precision(self, scale: Array) -> Array:
        return np.eye(3) + scale @ self.regressors.T @ self.regressors @ scale


def _estimate(parts: Sequence[_Part], strength: float, noise_scale: Array) -> tuple[Array, Array]:
    """Log evidence of a strength up to a constant, shape (n,), and the periodic part of all steps, shape (N, n).

    The weights of the monomials and the coefficients of every deployment are estimated together.
    """
    size, steps = parts[0].features.shape[1], sum(len(part.error) for part in parts)
    information, projection = np.eye(size) / PRIOR_STD**2, np.zeros((size, len(noise_scale)))
    squares, log_determinant = PRIOR_COUNT * noise_scale**2, 0.0
    # The errors of a deployment are features · weights + R c + noise. With c integrated out, their covariance in
    # variances of the noise is V = 1 + R S Rᵀ, and x − disturbance(x) is V⁻¹ x. So these sums, over independent
    # deployments, are Σ FᵀV⁻¹F, Σ FᵀV⁻¹e and Σ eᵀV⁻¹e of a linear regression with the noise V.
    for part in parts:
        features, error = part.features, part.error
        information = information + features.T @ (features - part.disturbance(features, strength))
        remaining = error - part.disturbance(error, strength)
        projection, squares = projection + features.T @ remaining, squares + np.sum(error * remaining, axis=0)
        log_determinant += part.log_determinant(strength)
    weights = np.linalg.solve(information, projection)
    # Integrated over the weights and the noise's variance, the density of the errors is a multivariate Student's t.
    residual_squares = squares - np.sum(projection * weights, axis=0)
    log_determinant += np.linalg.slogdet(information)[1]
    evidence = -0.5 * ((PRIOR_COUNT + steps) * np.log(residual_squares) + log_determinant)
    found = [part.coefficients(part.error - part.features @ weights, strength) for part in parts]
    return evidence, np.vstack([part.regressors[:, 1:] @ c[1:] for part, c in zip(parts, found, strict=True)])
