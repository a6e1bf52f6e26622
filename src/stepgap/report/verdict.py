"""What a run achieved, by state coordinate: its errors before and after learning, beside the noise floor.

The *verdict* on a coordinate compares its errors with the noise floor and with its range of use, the *change* its
errors before and after. An error far above the noise of a robot with little noise may be a small one.
An error counts as changed if its ratio differs from one by more than both 95 % intervals explain, and not if both are
near the noise floor. So nothing is claimed that noise explains.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from stepgap.control.gauss_newton import REACHED
from stepgap.control.reference import mean_of_known
from stepgap.experiment.bands import executed_steps_to_band, rms_interval, rmse_interval
from stepgap.experiment.outcome import TRACKED
from stepgap.experiment.run import Run
from stepgap.learning.observations import observe
from stepgap.records.missing import Missing
from stepgap.records.summary import Deployment
from stepgap.records.text import decimal
from stepgap.step import Array

ABOUT: Final = 1.05  # Factor between two errors without intervals up to which they count as equal

CLOSE: Final = 0.03
"""Errors up to this part of the range of use follow the targets, however little noise the robot has."""

NEAR_FLOOR: Final = 1.25
"""Errors up to this number of noise floors are at the noise floor, where that has no interval."""


@final
@dataclass(frozen=True, eq=False)
class Achievement:
    """Errors of a run with at least one finished deployment; a number that is not known is NaN.

    Attributes:
        run: The run.
    """

    run: Run

    @cached_property
    def rows(self) -> list[int]:
        """Numbers of the state coordinates that have targets, the only ones with errors."""
        return self.run.steps.tracking().tracked

    @property
    def first(self) -> Deployment:
        """The first finished deployment."""
        return self.run.deployments[0]

    @property
    def last(self) -> Deployment:
        """The last finished deployment."""
        return self.run.deployments[-1]

    @property
    def predicted(self) -> bool:
        """Whether `before` is the error of the nominal map's predictions, since no deployment used this map alone."""
        return self.first.residual != "none"

    @property
    def learned(self) -> bool:
        """Whether a deployment used what was learned, so that there is something to compare."""
        return self.last.residual != "none"

    @cached_property
    def before(self) -> Array:
        """RMSE of the first deployment, or of the nominal map's predictions of its steps; shape (n,)."""
        if not self.predicted:
            return self.first.rmse
        return np.sqrt(mean_of_known(self._nominal_errors**2))

    @cached_property
    def before_ends(self) -> Array:
        """Ends of the 95 % interval of `before`; shape (2, n)."""
        if self.predicted:
            return rms_interval(self._nominal_errors)
        return rmse_interval(self.run.steps.of_iteration(self.first.iteration))

    @property
    def after(self) -> Array:
        """RMSE of the last deployment; shape (n,)."""
        return self.last.rmse

    @cached_property
    def after_ends(self) -> Array:
        """Ends of the 95 % interval of `after`; shape (2, n)."""
        return rmse_interval(self.run.steps.of_iteration(self.last.iteration))

    @cached_property
    def floor(self) -> Array:
        """Noise floor; NaN too where it is so small that the plant has no noise; shape (n,)."""
        floor = self.run.noise_floor
        return np.where(floor > REACHED * self.run.space.state_scale, floor, np.nan)

    @property
    def parts(self) -> Array:
        """RMSE of the last deployment as parts of the ranges of use; shape (n,)."""
        return self.after / (2 * self.run.space.state_scale)

    @property
    def is_without_noise(self) -> bool:
        """Whether the noise floor is known, and zero in every coordinate."""
        return bool(np.isfinite(self.run.noise_floor).all() and np.isnan(self.floor).all())

    @property
    def band(self) -> tuple[str, Array]:
        """The band in which errors should stay, in words and by coordinate: a published error, or some noise floors."""
        published = self.run.compared_result
        if published:
            return f"{published.source}'s last errors", published.band
        return f"{TRACKED:g} noise floors", TRACKED * self.floor

    def steps_to_band(self) -> int | None:
        """Number of executed steps after which the errors stay in the band; None if they do not, or it is unknown."""
        logs = [self.run.steps.of_iteration(deployment.iteration) for deployment in self.run.deployments]
        return executed_steps_to_band(logs, self.band[1])

    def beyond(self) -> dict[int, float]:
        """Errors of the last deployment above three noise floors, by the index of the coordinate, in noise floors."""
        ratios = self.after / self.floor
        return {row: float(ratio) for row, ratio in enumerate(ratios) if ratio > TRACKED}

    def in_words(self, row: int) -> str:
        """Error of a coordinate in the last deployment, by its size and by the noise."""
        floors = self.after[row] / self.floor[row]
        return f"{decimal(100 * self.parts[row], 2)} % of its range ({decimal(floors, 2)} noise floors)"

    @property
    def far_rows(self) -> list[int]:
        """Coordinates whose errors have another cause than noise: far above it or, if it is unknown, in the range."""
        beyond = self.beyond()
        unknown = np.isnan(self.floor) & (self.parts > CLOSE)
        return [row for row in self.rows if row in beyond or unknown[row]]

    def changes(self) -> list[float]:
        """Change of the error of each of the `rows`: 1 larger, −1 smaller, 0 if noise explains it, NaN if not known."""
        return [self._change(row) for row in self.rows]

    def change_in_words(self, row: int) -> str:
        """Change of the error of a coordinate, for a table."""
        change = self._change(row)
        if np.isnan(change):
            return "–"
        factor = self.before[row] / self.after[row] if change < 0 else self.after[row] / self.before[row]
        return {-1: f"{decimal(factor, 2)} times smaller", 1: f"{decimal(factor, 2)} times larger"}.get(
            int(change), "no clear change"
        )

    def verdict_in_words(self, row: int) -> str:
        """Comparison of the errors of a coordinate with its noise floor, for a table."""
        floor = self.floor[row]
        low, high = self.run.noise_floor_interval[:, row]
        if np.isnan(floor) or np.isnan(self.after[row]):
            return "no noise" if self.is_without_noise else "–"
        if self.is_doubtful(row):
            return "–"
        if row in self.beyond():
            verdict = "follows" if self.parts[row] <= CLOSE else "not tracked"
            return f"{verdict}: {decimal(100 * self.parts[row], 2)} % of its range"
        steady = self.last.steady_rmse[row]
        reached = self.after[row] if np.isnan(steady) else steady
        if reached < (low if np.isfinite(low) else floor / NEAR_FLOOR):
            return "below the noise floor"
        if reached <= (high if np.isfinite(high) else floor * NEAR_FLOOR):
            return "at the noise floor"
        return f"{decimal(reached / floor, 2)} noise floors"

    def is_doubtful(self, row: int) -> bool:
        """Whether an error became larger, and its noise floor, found from the same steps, grew with it."""
        return not self.run.summary.noise_floor_measured and self._change(row) > 0

    def _change(self, row: int) -> float:
        before = self.before[row]
        after = self.after[row]
        if (self.first is self.last and not self.predicted) or not before > 0 or not after > 0:
            return np.nan
        if self.run.summary.noise_floor_measured and max(before, after) <= NEAR_FLOOR * self.floor[row]:
            return 0.0  # a floor that is found from the same steps grows with their errors
        return clear_change(before, after, np.array([self.before_ends[:, row], self.after_ends[:, row]]))

    @cached_property
    def _nominal_errors(self) -> Array:
        """Errors of the nominal map's predictions in the first deployment; none if it is missing; shape (k, n)."""
        nominal = self.run.nominal
        if isinstance(nominal, Missing):
            return np.empty((0, len(self.first.rmse)))
        return observe(self.run.steps.of_iteration(self.first.iteration).tracking(), nominal).error


def clear_change(before: float, after: float, ends: Array) -> float:
    """Whether an error became larger (1) or smaller (−1), or neither by more than its intervals explain (0).

    Args:
        ends: 95 % intervals of both; shape (2, 2), NaN where they are not known.
    """
    explained = np.log(ABOUT)
    ratio = np.log(after / before)
    if (ends > 0).all():
        half_widths = np.log(ends[:, 1] / ends[:, 0]) / 2
        explained = np.linalg.norm(half_widths)
    return float(np.sign(ratio)) if abs(ratio) > explained else 0.0
