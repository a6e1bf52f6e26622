"""What recorded steps say of the nominal map: its error at each of them, and what came before.

The *context* of a step is what is known of the past when it starts, one row of 2n + m + 1 numbers: error, applied
command and state of the step before in the same deployment, and how many steps were recorded before it. All but
the last are in half ranges, from the middle of the range; the first step of a deployment has zeros there.
"""

from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.learning.residual import Hindsight
from stepgap.learning.step_log import StepLog
from stepgap.learning.step_table import Indices
from stepgap.step import Array, StepMap, StepRecord, StepSpace


@final
@dataclass(frozen=True, eq=False)
class Observations:
    """Errors of the nominal map at N steps, in the order in which they happened.

    Attributes:
        space: Names the coordinates, and gives the fixed scales in which they are measured.
        state: State at the apex each step started from; shape (N, n).
        applied_command: Command the joints received; shape (N, m).
        error: Actual − nominal next state; shape (N, n).
        context: What was known of the past; shape (N, 2n + m + 1). None: nothing but the order of the steps.
        yaw: Yaw at which each step started [rad], NaN where it is not known; shape (N,). None: it is not known at all.
        deployment: Number of the deployment it belongs to; shape (N,). None: all of them to one.

    Raises:
        ValueError: A wrong shape, or a number that is not finite.
    """

    space: StepSpace
    state: Array
    applied_command: Array
    error: Array
    context: Array | None = None
    yaw: Array | None = None
    deployment: Indices | None = None

    def __post_init__(self) -> None:
        state, command = self.space.state_names, self.space.command_names
        _check_rows(self.state, "state", state)
        _check_rows(self.applied_command, "applied_command", command)
        _check_rows(self.error, "error", state)
        if self.context is not None:
            errors = (f"error of {name}" for name in state)
            _check_rows(self.context, "context", (*errors, *command, *state, "steps before"))
        parts = (self.state, self.applied_command, self.error, self.context, self.yaw, self.deployment)
        sizes = [len(part) for part in parts if part is not None]
        if len(set(sizes)) != 1:
            raise ValueError(
                f"states, applied commands, errors, contexts, yaws and deployments must be equally many, not {sizes}"
            )

    def __len__(self) -> int:
        return len(self.state)

    def points(self, hindsight: Hindsight) -> Array:
        """State, applied command, and what of the past is an input; shape (N, n + m + c)."""
        n, m = len(self.space.state), len(self.space.command)
        context = self.context
        if context is None:
            if hindsight.features != "none":
                raise ValueError(f"features {hindsight.features!r} need the context of the steps; observe a log")
            context = np.arange(float(len(self)))[:, None] * np.eye(2 * n + m + 1)[-1]
        return np.hstack([self.state, self.applied_command, hindsight.inputs(context, n)])


def observe(log: StepLog, nominal: StepMap) -> Observations:
    """The nominal map's error at the steps of a log that ended with an apex, at the commands applied.

    A step that the nominal map says must fail has no error, and is left out.
    """
    error = log.next_state - nominal.evaluate(log.state, log.applied).next_state
    told = _told(nominal.space, error, log.applied, log.state)
    before = np.where(log.follows[:, None], np.roll(told, 1, axis=0), 0.0)
    context = np.hstack([before, np.arange(float(len(log)))[:, None]])
    known = np.isfinite(error).all(axis=1)
    rows = log.state[known], log.applied[known], error[known], context[known], log.yaw[known], log.deployment[known]
    return Observations(nominal.space, *rows)


def next_context(log: StepLog, nominal: StepMap, iteration: int) -> Array:
    """Context of the step that follows a log; shape (2n + m + 1,).

    Args:
        log: All steps before.
        nominal: Map whose errors count.
        iteration: Deployment that the step belongs to.
    """
    *_, last = [None, *log]
    if last is None or last.iteration != iteration:
        return np.append(np.zeros(2 * len(log.space.state) + len(log.space.command)), len(log))
    return context_after(last.record, error_of(last.record, nominal), log.space, len(log))


def context_after(record: StepRecord, error: Array, space: StepSpace, steps: int) -> Array:
    """Context of the step that follows another one; shape (2n + m + 1,).

    Args:
        record: The step before.
        error: The nominal map's error at it; shape (n,).
        space: Of both.
        steps: How many steps were recorded, the one before included.
    """
    return np.append(_told(space, error, record.applied, record.state), steps)


def error_of(record: StepRecord, nominal: StepMap) -> Array:
    """Actual − nominal next state of one step, NaN where either has none; shape (n,)."""
    return record.next_state - nominal.evaluate(record.state, record.applied).next_state


def _told(space: StepSpace, error: Array, applied_command: Array, state: Array) -> Array:
    """What a step tells the next one, in half ranges; shape (…, 2n + m). An error that is not known is none."""
    command = space.point_of(applied_command)
    parts = [np.nan_to_num(error) / space.state_scale, command, (state - space.state_centre) / space.state_scale]
    return np.concatenate(parts, axis=-1)


def _check_rows(array: Array, name: str, columns: tuple[str, ...]) -> None:
    if np.ndim(array) != 2 or np.shape(array)[1] != len(columns):
        raise ValueError(f"{name} must have the columns {', '.join(columns)}, not the shape {np.shape(array)}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name} must be finite, but row {row} is {array[row].tolist()}; leave failed steps out")
