"""What executed steps say about the robot and its state: lagged inputs, and noise that varies.

Every statement comes from a regression of the nominal map's error in state and command (quadratic, as far as there are
steps enough), whose residual is what neither can explain:

- *Lagged inputs*: quantities of the step before reduce that residual. Then the state is not sufficient to predict the
  next one, or a disturbance changes slowly. Judged by an F test and by the reduction of the leave-one-out error. The
  setting `lagged_inputs = "auto"` adds such inputs to a residual only where this is found.
- *Noise that depends on the state*: the squared residual varies with state or command (Breusch & Pagan 1979, in the
  form of Koenker 1981), although the learned models have one noise level.
"""

from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.special import chdtrc, fdtrc  # the tails of scipy.stats, without its long import

from stepgap.gauss.linear_regression import LinearFit, fit_linear
from stepgap.gauss.monomials import monomials
from stepgap.learning.observations import Observations
from stepgap.learning.residual import HistoryInputs
from stepgap.learning.settings import LAGGED_INPUTS, LaggedInputs
from stepgap.step import Array

CONFIDENT = 0.001
"""Largest p-value of a finding: several hypotheses are tested in every deployment."""

SMALLEST_GAIN = 0.05
"""Smallest reduction of the error by lagged inputs that is worth a sentence."""

AT_A_BOUND = 0.99
"""A command counts as at its bound beyond this part of its half range."""

FEWEST_STEPS_PER_WEIGHT = 4
"""Fewest steps for each weight of a regression."""

HISTORY: Final[tuple[LaggedInputs, ...]] = tuple(name for name in LAGGED_INPUTS if name != "none")
"""Groups of history inputs that are tried; the names are values of the setting `learning.lagged_inputs`."""


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """What the steps of one deployment say; arrays over the state coordinates are NaN where the steps are too few.

    Attributes:
        steps: Number of steps with a known error.
        gains: By group of history inputs, the part of the error that they explain beyond chance, leave-one-out; 0
            where the F test does not confirm it; shape (n,).
        heteroscedasticity: Standard deviation of the unexplained error where it is predicted to be large (upper third),
            in that where it is predicted to be small; 1 where the test does not confirm a dependence; shape (n,).
    """

    steps: int
    gains: dict[str, Array]
    heteroscedasticity: Array

    @property
    def lagged(self) -> bool:
        """Whether the step before helps to predict some coordinate by more than `SMALLEST_GAIN`."""
        return any(bool((gains > SMALLEST_GAIN).any()) for gains in self.gains.values())

    @property
    def known(self) -> bool:
        """Whether the steps were enough to judge lagged inputs and noise."""
        return bool(np.isfinite(self.heteroscedasticity).all())


def diagnose(observed: Observations) -> Diagnosis:
    """Diagnoses the steps of one deployment, given the errors of the nominal map with their history."""
    n, basis = len(observed.space.state), _basis(observed)
    if basis is None or observed.history is None:
        unknown = np.full(n, np.nan)
        return Diagnosis(len(observed), dict.fromkeys(HISTORY, unknown), unknown)
    known = HistoryInputs(context_inputs=observed.context_inputs)
    basis = np.hstack([basis, known.of(observed.history, n)])
    plain = fit_linear(basis, observed.error)
    gains = {}
    for name in HISTORY:
        inputs = replace(known, lagged_inputs=name).of(observed.history, n)
        gains[name] = _gains(plain, fit_linear(np.hstack([basis, inputs]), observed.error))
    heteroscedasticity = np.array([_heteroscedasticity(_scaled(observed), residual) for residual in plain.residual.T])
    return Diagnosis(len(observed), gains, heteroscedasticity)


def part_at_bounds(observed: Observations) -> Array:
    """Part of the steps at which each command was at one of its bounds; NaN without steps; shape (m,)."""
    if not len(observed):
        return np.full(len(observed.space.command), np.nan)
    return np.mean(np.abs(observed.space.point_of(observed.command)) > AT_A_BOUND, axis=0)


def _scaled(observed: Observations) -> Array:
    space = observed.space
    return space.scaled_inputs(observed.state, observed.command)


def _basis(observed: Observations) -> Array | None:
    """Columns of the regression in state and command: quadratic or linear; None if the steps are too few for these."""
    points = _scaled(observed)
    history = points.shape[1] + len(observed.space.state) + observed.context_inputs
    most = points.shape[1] + history
    for degree in (2, 1):
        basis = monomials(points, degree)
        if len(observed) >= FEWEST_STEPS_PER_WEIGHT * (basis.shape[1] + most):
            return basis
    return None


def _gains(plain: LinearFit, more: LinearFit) -> Array:
    """Part by which further columns reduce the leave-one-out error; 0 where an F test does not confirm them; (n,)."""
    before, after = np.sum(plain.residual**2, axis=0), np.sum(more.residual**2, axis=0)
    added, free = more.rank - plain.rank, len(plain.residual) - more.rank
    if added == 0:
        return np.zeros(len(before))
    statistic = np.maximum(before - after, 0) / added / np.maximum(after / free, 1e-300)
    errors = np.sqrt(np.mean(more.left_out**2, axis=0)), np.sqrt(np.mean(plain.left_out**2, axis=0))
    reduced = 1 - np.divide(*errors, out=np.ones(len(before)), where=errors[1] > 0)
    return np.where(fdtrc(added, free, statistic) > CONFIDENT, 0.0, np.maximum(reduced, 0.0))


def _heteroscedasticity(points: Array, residual: Array) -> float:
    """How much the unexplained error varies with state and command; 1 if a test does not confirm that it does."""
    squares = residual**2
    total = np.sum((squares - squares.mean()) ** 2)
    if total == 0:
        return 1.0
    found = fit_linear(monomials(points, 1), squares[:, None])
    unexplained = found.residual[:, 0]
    statistic = len(squares) * (1 - unexplained @ unexplained / total)
    if chdtrc(found.rank - 1, statistic) > CONFIDENT:
        return 1.0
    predicted = squares - unexplained
    low, high = np.quantile(predicted, [1 / 3, 2 / 3])
    large, small = squares[predicted >= high].mean(), squares[predicted <= low].mean()
    return float(np.sqrt(large / small)) if small > 0 else np.inf
