"""Observations: the error of the nominal map at each recorded step, computed from `Steps`, and the history of the step.

The *history* of a step is what is known besides state and command before its command acts, a row of 1 + q numbers: the
number of steps recorded before it, and the q context inputs. These are those of the step itself, as its touchdown finds
them; until then, those of the step before in the same deployment, and zero for the first one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from stepgap.learning.regression import TrainingData
from stepgap.learning.residual import HistoryInputs
from stepgap.learning.steps import Labels, Steps
from stepgap.step import Array, StepMap, StepRecord, StepSpace


@final
@dataclass(frozen=True, eq=False)
class Observations:
    """Errors of the nominal map at N steps, in the order in which they happened.

    Attributes:
        space: Names and scales of the coordinates.
        state: State at the section each step started from; shape (N, n).
        command: Command requested of the joints; shape (N, m).
        error: Actual − nominal next state; shape (N, n).
        history: History of each step; shape (N, 1 + q). None: only the order of the steps is known.

    Raises:
        ValueError: A wrong shape, or a number that is not finite.
    """

    space: StepSpace
    state: Array
    command: Array
    error: Array
    history: Array | None = None

    def __post_init__(self) -> None:
        state = self.space.state_names
        command = self.space.command_names
        _check_rows(self.state, "state", state)
        _check_rows(self.command, "command", command)
        _check_rows(self.error, "error", state)
        if self.history is not None:
            inputs = (quantity.name for quantity in self.space.context_inputs)
            _check_rows(self.history, "history", ("steps before", *inputs))
        sizes = [len(part) for part in (self.state, self.command, self.error, self.history) if part is not None]
        if len(set(sizes)) != 1:
            raise ValueError(f"states, commands, errors and histories must have one length, not {sizes}")

    def __len__(self) -> int:
        return len(self.state)

    def selected(self, rows: Labels | NDArray[np.bool_]) -> "Observations":
        """Returns the observations in some rows, given by ascending indices or by a mask (N,)."""
        history = None if self.history is None else self.history[rows]
        return Observations(self.space, self.state[rows], self.command[rows], self.error[rows], history)

    @property
    def context_inputs(self) -> int:
        """Number of context inputs that the history has, q."""
        return 0 if self.history is None else len(self.space.context_inputs)

    def points(self, history_inputs: HistoryInputs) -> Array:
        """State, command and history inputs; shape (N, n + m + c)."""
        history = np.arange(float(len(self)))[:, None] if self.history is None else self.history
        return np.hstack([self.state, self.command, history_inputs.of(history)])

    def training_data(self, history_inputs: HistoryInputs, coordinate: int) -> TrainingData:
        """Training data of the regression of one state coordinate."""
        space = self.space
        points = self.points(history_inputs)
        others = points.shape[1] - len(space.state) - len(space.command)
        return TrainingData(
            points,
            self.error[:, coordinate].copy(),
            np.concatenate([space.state_centre, space.command_centre, np.zeros(others)]),
            np.concatenate([space.state_scale, space.command_scale, np.ones(others)]),
            float(space.state_scale[coordinate]),
            history_inputs.timed,
        )


def no_observations(space: StepSpace) -> Observations:
    """Observations of no step."""
    n = len(space.state)
    m = len(space.command)
    history = np.empty((0, 1 + len(space.context_inputs)))
    return Observations(space, np.empty((0, n)), np.empty((0, m)), np.empty((0, n)), history)


def observe(log: Steps, nominal: StepMap) -> Observations:
    """Computes the nominal map's error at the steps of a log that ended at their section, at the commands requested.

    What limits remove from a command is thus a part of the error. A step that fails on the nominal map has no error and
    is omitted, and so are steps whose states are doubtful.
    """
    error = log.next_state - nominal.evaluate(log.state, log.requested).next_state
    history = np.hstack([np.arange(float(len(log)))[:, None], _context_inputs(nominal.space, log)])
    usable = np.isfinite(error).all(axis=1) & ~log.doubtful
    return Observations(nominal.space, log.state[usable], log.requested[usable], error[usable], history[usable])


def next_history(log: Steps, space: StepSpace, iteration: int) -> Array:
    """History of the step that follows a log; shape (1 + q,).

    Args:
        log: All earlier steps.
        space: Names the context inputs.
        iteration: Deployment that the step belongs to.
    """
    last = log.last
    context = last.record.context if last is not None and last.iteration == iteration else {}
    return np.append(len(log), context_inputs_of(context, space))


def context_inputs_of(context: Mapping[str, float], space: StepSpace) -> Array:
    """Context inputs of a step in units of their scales, zero where one is unknown; shape (q,)."""
    values = [context.get(quantity.name, 0.0) / quantity.input_scale for quantity in space.context_inputs]
    return np.nan_to_num(np.array(values, float))


def _context_inputs(space: StepSpace, log: Steps) -> Array:
    """Context inputs of all steps of a log; shape (N, q)."""
    values = np.zeros((len(log), len(space.context_inputs)))
    names = log.space.context_names
    for column, quantity in enumerate(space.context_inputs):
        if quantity.name in names:
            values[:, column] = np.nan_to_num(log.context[:, names.index(quantity.name)] / quantity.input_scale)
    return values


def error_of(record: StepRecord, nominal: StepMap) -> Array:
    """Actual − nominal next state of one step, NaN where one of them is missing; shape (n,)."""
    return record.next_state - nominal.evaluate(record.state, record.requested).next_state


def _check_rows(array: Array, name: str, columns: tuple[str, ...]) -> None:
    if np.ndim(array) != 2 or np.shape(array)[1] != len(columns):
        raise ValueError(f"{name} must have the columns {', '.join(columns)}, not the shape {np.shape(array)}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name} must be finite, but row {row} is {array[row].tolist()}; leave failed steps out")
