"""What the steps of a deployment say about the robot and its state: memory, noise that varies, authority.

Every statement comes from a regression of the nominal map's error in state and command (quadratic, as far as there are
steps enough), whose residual is what neither can explain:

- *Memory*: quantities of the step before reduce that residual. Then the state is not sufficient to predict the next
  one, or a disturbance changes slowly. Judged by an F test and by the reduction of the leave-one-out error.
- *Noise that depends on the state*: the squared residual varies with state or command (Breusch & Pagan 1979, in the
  form of Koenker 1981), although the learned models have one noise level.
- *Authority*: the part of steps whose command is at a bound, and how far the commands move the next state within their
  bounds.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.stats import chi2, f

from stepgap.learning.observations import Observations
from stepgap.learning.polynomial import monomials
from stepgap.step import Array, StepMap

CONFIDENT = 0.001
"""Largest p-value of a finding: several hypotheses are tested in every deployment."""

SMALLEST_GAIN = 0.05
"""Smallest reduction of the error by memory that is worth a sentence."""

AT_A_BOUND = 0.99
"""A command counts as at its bound beyond this part of its half range."""

FEWEST_STEPS_PER_WEIGHT = 4
"""Fewest steps for each weight of a regression."""

HISTORY: Final = ("previous_error", "previous_step")
"""Groups of history inputs that are tried; the names are values of the setting `learning.lagged_inputs`."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the steps of one deployment say; arrays over the state coordinates are NaN where the steps are too few.

    Attributes:
        steps: Number of steps with a known error.
        gains: By group of history inputs, the part of the error that they explain beyond chance, leave-one-out; 0
            where the F test does not confirm it; shape (n,).
        noise_ratio: Standard deviation of the unexplained error where it is predicted to be large (upper third) in that
            where it is predicted to be small; 1 where the test does not confirm a dependence; shape (n,).
        at_bounds: Part of the steps at which each command was at one of its bounds; shape (m,).
        authority: Half the range over which each command moves the next state, in half ranges of use; shape (n, m).
    """

    steps: int
    gains: dict[str, Array]
    noise_ratio: Array
    at_bounds: Array
    authority: Array

    @property
    def known(self) -> bool:
        """Whether the steps were enough to judge memory and noise."""
        return bool(np.isfinite(self.noise_ratio).all())


def diagnose(observed: Observations, step_map: StepMap) -> Diagnosis:
    """Diagnoses the steps of one deployment.

    Args:
        observed: Errors of the nominal map at the steps, with their history.
        step_map: Best map known, for the effect of the commands.
    """
    space, count = observed.space, len(observed)
    n, m = len(space.state), len(space.command)
    at_bounds = np.full(m, np.nan)
    authority = np.full((n, m), np.nan)
    if count:
        at_bounds = np.mean(np.abs(space.point_of(observed.command)) > AT_A_BOUND, axis=0)
        slopes = step_map.jacobian(observed.state, observed.command)[..., n:]
        known = slopes[np.isfinite(slopes).all(axis=(1, 2))]
        if len(known):
            authority = np.abs(np.median(known, axis=0)) * space.command_scale / space.state_scale[:, None]
    basis = _basis(observed)
    if basis is None or observed.history is None:
        unknown = np.full(n, np.nan)
        return Diagnosis(count, dict.fromkeys(HISTORY, unknown), unknown, at_bounds, authority)
    previous_error = observed.history[:, :n]
    previous_step = observed.history[:, : 2 * n + m]
    gains = {
        name: np.array([_gain(basis, inputs, values) for values in observed.error.T])
        for name, inputs in zip(HISTORY, (previous_error, previous_step), strict=True)
    }
    noise_ratio = np.array([_noise_ratio(observed, basis, values) for values in observed.error.T])
    return Diagnosis(count, gains, noise_ratio, at_bounds, authority)


def _scaled(observed: Observations) -> Array:
    space = observed.space
    state = (observed.state - space.state_centre) / space.state_scale
    return np.hstack([state, space.point_of(observed.command)])


def _basis(observed: Observations) -> Array | None:
    """Columns of the regression in state and command: quadratic or linear; None if the steps are too few for these."""
    points = _scaled(observed)
    most = points.shape[1] * 2 + len(observed.space.state)  # with the columns of the history
    for degree in (2, 1):
        basis = monomials(points, degree)
        if len(observed) >= FEWEST_STEPS_PER_WEIGHT * (basis.shape[1] + most):
            return basis
    return None


def _gain(basis: Array, inputs: Array, values: Array) -> float:
    """Part by which further columns reduce the leave-one-out error; 0 if an F test does not confirm them."""
    inputs = inputs[:, inputs.std(axis=0) > 0]
    whole = np.hstack([basis, inputs])
    without, alone = _regression(basis, values)
    with_inputs, more = _regression(whole, values)
    free = len(values) - np.linalg.matrix_rank(whole)
    added = np.linalg.matrix_rank(whole) - np.linalg.matrix_rank(basis)
    if added == 0 or without @ without == 0:
        return 0.0
    statistic = (without @ without - with_inputs @ with_inputs) / added / max(with_inputs @ with_inputs / free, 1e-300)
    if f.sf(statistic, added, free) > CONFIDENT:
        return 0.0
    return max(0.0, float(1 - np.sqrt(np.mean(more**2) / np.mean(alone**2))))


def _regression(basis: Array, values: Array) -> tuple[Array, Array]:
    """Residuals of a regression, and those of each value predicted from all others (Allen's PRESS)."""
    left, singular, _ = np.linalg.svd(basis, full_matrices=False)
    left = left[:, singular > 1e-10 * singular[0]]
    residual = values - left @ (left.T @ values)
    leverage = np.minimum(np.sum(left**2, axis=1), 1 - 1e-9)
    return residual, residual / (1 - leverage)


def _noise_ratio(observed: Observations, basis: Array, values: Array) -> float:
    """How much the unexplained error varies with state and command; 1 if a test does not confirm that it does."""
    residual, _ = _regression(basis, values)
    squares, linear = residual**2, monomials(_scaled(observed), 1)
    total = np.sum((squares - squares.mean()) ** 2)
    if total == 0:
        return 1.0
    unexplained, _ = _regression(linear, squares)
    predicted = squares - unexplained
    statistic = len(squares) * (1 - unexplained @ unexplained / total)
    if chi2.sf(statistic, np.linalg.matrix_rank(linear) - 1) > CONFIDENT:
        return 1.0
    low, high = np.quantile(predicted, [1 / 3, 2 / 3])
    large, small = squares[predicted >= high].mean(), squares[predicted <= low].mean()
    return float(np.sqrt(large / small)) if small > 0 else np.inf
