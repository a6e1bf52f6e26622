"""Steps to learn from as arrays, from any source."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.step_log import StepLog
from stepgap.step import Array, StepSpace

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
    """

    space: StepSpace
    state: Array
    command: Array
    next_state: Array
    target: Array | None
    predicted: Array | None
    deployment: Labels
    left_out: Mapping[str, int] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.state)

    @property
    def error(self) -> Array:
        """Actual − nominal next state; shape (N, n)."""
        if self.predicted is None:
            raise ValueError("these steps have no predictions")
        return self.next_state - self.predicted

    def with_predictions(self, predicted: Array, why_not: str) -> "StepTable":
        """Returns the steps with predictions of the next state; shape (N, n), NaN where there is no prediction."""
        known = np.isfinite(predicted).all(axis=1)
        failed = int((~known).sum())
        return StepTable(
            self.space,
            self.state[known],
            self.command[known],
            self.next_state[known],
            None if self.target is None else self.target[known],
            predicted[known],
            self.deployment[known],
            {**self.left_out, **({why_not: failed} if failed else {})},
        )


def tabulate(log: StepLog) -> StepTable:
    """Converts the completed steps of a log; its predictions are omitted: they may be those of a corrected map."""
    known = log.completed()
    left_out = {"that ended without a next state": log.falls} if log.falls else {}
    return StepTable(
        log.space, known.state, known.requested, known.next_state, known.target, None, known.deployment, left_out
    )


def describe_left_out(left_out: Mapping[str, int]) -> str:
    """Formats the numbers of excluded rows and their reasons."""
    return ", ".join(f"{count} {reason}" for reason, count in left_out.items() if count) or "none"
