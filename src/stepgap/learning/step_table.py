"""Steps to learn from as arrays, from any source."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.step_log import StepLog
from stepgap.step import Array, StepSpace, StepStatus

Labels = NDArray[np.intp]
"""Number of the deployment, fold or block that each step belongs to, from 0."""


@dataclass(frozen=True, eq=False)
class StepTable:
    """Steps that ended with a next state; every number is finite.

    Attributes:
        space: Names, units and ranges.
        state: State before each step; shape (N, n).
        command: Command requested of the joints, or a substitute for it; shape (N, m).
        next_state: State after it; shape (N, n).
        target: State wanted after it; None if unknown; shape (N, n).
        predicted: Next state as the nominal map predicted it; None if unknown; shape (N, n).
        deployment: Number of the deployment it belongs to; shape (N,).
        left_out: Number of excluded rows by reason, such as "that ended without a next state"; no zeros.
        yaw: Yaw at which each step started [rad], NaN where it is unknown; None: all are unknown; shape (N,).
    """

    space: StepSpace
    state: Array
    command: Array
    next_state: Array
    target: Array | None
    predicted: Array | None
    deployment: Labels
    left_out: Mapping[str, int] = field(default_factory=dict)
    yaw: Array | None = None

    def __len__(self) -> int:
        return len(self.state)

    @property
    def error(self) -> Array:
        """Actual − nominal next state; shape (N, n)."""
        if self.predicted is None:
            raise ValueError("these steps have no predictions")
        return self.next_state - self.predicted

    @property
    def follows(self) -> NDArray[np.bool_]:
        """Whether each step starts from the state in which the step in the row above ended; shape (N,)."""
        starts = (self.state[1:] == self.next_state[:-1]).all(axis=1)
        return np.append(False, starts & (self.deployment[1:] == self.deployment[:-1]))[: len(self)]

    def selected(self, rows: Labels | NDArray[np.bool_]) -> "StepTable":
        """Returns some of the steps, given by their indices or by a mask (N,)."""
        return replace(
            self,
            state=self.state[rows],
            command=self.command[rows],
            next_state=self.next_state[rows],
            target=None if self.target is None else self.target[rows],
            predicted=None if self.predicted is None else self.predicted[rows],
            deployment=self.deployment[rows],
            yaw=None if self.yaw is None else self.yaw[rows],
        )

    def with_predictions(self, predicted: Array, why_not: str) -> "StepTable":
        """Returns the steps with predictions of the next state; shape (N, n), NaN where there is no prediction."""
        known = np.flatnonzero(np.isfinite(predicted).all(axis=1))
        failed = len(self) - len(known)
        left_out = {**self.left_out, **({why_not: failed} if failed else {})}
        return replace(self, predicted=predicted, left_out=left_out).selected(known)


def tabulate(log: StepLog) -> StepTable:
    """Converts the completed steps of a log; its predictions are omitted: they may be those of a corrected map."""
    done = np.array([logged.record.status == StepStatus.OK for logged in log], bool)
    left_out = {"that ended without a next state": log.failed_steps} if log.failed_steps else {}
    steps = (log.space, log.state, log.requested, log.next_state, log.target, None, log.deployment, left_out, log.yaw)
    return StepTable(*steps).selected(done)


def describe_left_out(left_out: Mapping[str, int]) -> str:
    """Formats the numbers of excluded rows and their reasons."""
    return ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count) or "none"
