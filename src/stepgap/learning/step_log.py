"""The append-only record of every executed step, in memory."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array, StepRecord, StepSpace, StepStatus


@dataclass(frozen=True, eq=False)
class LoggedStep:
    """One executed step with its target and prediction; one row of `steps.csv`.

    Attributes:
        iteration: Deployment it belongs to, from 0.
        step: Its number within the deployment, from 1; exploration steps come before, up to number 0.
        target: State wanted at its end; for an exploration step the predicted one; shape (n,).
        predicted: State that the controller's map predicted for the command; NaN where the controller found no
            command that makes a step; shape (n,).
        std: Standard deviation of that prediction, zero for a map without one; shape (n,).
        record: Record of the execution.
    """

    iteration: int
    step: int
    target: Array
    predicted: Array
    std: Array
    record: StepRecord


class StepLog:
    """Steps in the order in which they were executed; immutable, `log + steps` is a longer one.

    Args:
        space: Names of their state and command.
        steps: The steps of the log.
    """

    def __init__(self, space: StepSpace, steps: Iterable[LoggedStep] = ()):
        self.space = space
        self._steps = tuple(steps)

    def __len__(self) -> int:
        return len(self._steps)

    def __iter__(self) -> Iterator[LoggedStep]:
        return iter(self._steps)

    def __add__(self, steps: Iterable[LoggedStep]) -> "StepLog":
        """Returns a log of these steps followed by others."""
        return StepLog(self.space, (*self._steps, *steps))

    @property
    def last(self) -> LoggedStep | None:
        """The latest step; None if there is none."""
        return self._steps[-1] if self._steps else None

    def of_iteration(self, iteration: int) -> "StepLog":
        """The steps of one deployment."""
        return StepLog(self.space, (logged for logged in self._steps if logged.iteration == iteration))

    def tracking(self) -> "StepLog":
        """The steps that tracked the reference; exploration steps, up to number 0, had other targets."""
        return StepLog(self.space, (logged for logged in self._steps if logged.step > 0))

    def completed(self) -> "StepLog":
        """The steps that ended at their section: those that can be learned from."""
        return StepLog(self.space, (logged for logged in self._steps if logged.record.status == StepStatus.OK))

    def tracking_errors(self) -> Array:
        """Next state − target of the completed steps that tracked the reference; shape (k, n)."""
        tracked = self.tracking().completed()
        return tracked.next_state - tracked.target

    @property
    def iterations(self) -> list[int]:
        """Numbers of the deployments in it, in ascending order."""
        return sorted({logged.iteration for logged in self._steps})

    @property
    def failed_steps(self) -> int:
        """Number of steps that ended without a next state."""
        return sum(logged.record.status != StepStatus.OK for logged in self._steps)

    @property
    def yaw(self) -> Array:
        """Yaw at the start of each step [rad], NaN where it is unknown; shape (N,)."""
        before = np.roll([logged.record.yaw_after for logged in self._steps], 1)
        return np.where(self.follows, before, np.nan)

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each step directly followed the one before it in this log; shape (N,)."""
        same, next_one = (np.diff(label, prepend=label[:1]) for label in (self.deployment, self.number))
        return (same == 0) & (next_one == 1)

    @property
    def doubtful(self) -> NDArray[np.bool_]:
        """Whether a sensor was doubtful in a step, or in the one that directly followed; shape (N,).

        The fault may have begun before it was found, so that the state at the end of the step before is doubtful, too.
        """
        own = np.array([logged.record.status == StepStatus.DOUBTFUL for logged in self._steps], bool)
        return own | np.roll(own & self.follows, -1)

    @property
    def deployment(self) -> NDArray[np.intp]:
        """Number of the deployment that each step belongs to; shape (N,)."""
        return np.array([logged.iteration for logged in self._steps], np.intp)

    @property
    def number(self) -> NDArray[np.intp]:
        """Number of each step in its deployment; shape (N,)."""
        return np.array([logged.step for logged in self._steps], np.intp)

    @property
    def state(self) -> Array:
        """States at the start of each step; shape (N, n)."""
        return self._column([logged.record.state for logged in self._steps], len(self.space.state))

    @property
    def requested(self) -> Array:
        """Commands requested of the joints; shape (N, m)."""
        return self._column([logged.record.requested for logged in self._steps], len(self.space.command))

    @property
    def applied(self) -> Array:
        """Commands applied; shape (N, m)."""
        return self._column([logged.record.applied for logged in self._steps], len(self.space.command))

    @property
    def next_state(self) -> Array:
        """States at the end of each step, NaN where it failed; shape (N, n)."""
        return self._column([logged.record.next_state for logged in self._steps], len(self.space.state))

    @property
    def true_next_state(self) -> Array:
        """True states at the end of each step, NaN where unknown; shape (N, n)."""
        return self._column([logged.record.true_next_state for logged in self._steps], len(self.space.state))

    @property
    def target(self) -> Array:
        """Targets; shape (N, n)."""
        return self._column([logged.target for logged in self._steps], len(self.space.state))

    @property
    def predicted(self) -> Array:
        """Predictions of the controller's map; shape (N, n)."""
        return self._column([logged.predicted for logged in self._steps], len(self.space.state))

    @property
    def std(self) -> Array:
        """Standard deviations of the predictions; shape (N, n)."""
        return self._column([logged.std for logged in self._steps], len(self.space.state))

    @staticmethod
    def _column(rows: list[Array], width: int) -> Array:
        return np.array(rows, float).reshape(len(rows), width)


def joined(logs: Sequence[StepLog]) -> StepLog:
    """Concatenates one or more logs and numbers their deployments consecutively."""
    merged = StepLog(logs[0].space)
    for log in logs:
        first = max(merged.iterations, default=-1) + 1
        merged += [replace(logged, iteration=logged.iteration + first) for logged in log]
    return merged


def as_past(known: StepLog) -> StepLog:
    """Steps renumbered as deployments before number 0."""
    count = max(known.iterations, default=-1) + 1
    return StepLog(known.space, (replace(logged, iteration=logged.iteration - count) for logged in known))
