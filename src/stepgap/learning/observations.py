"""Observations: the error of the nominal map at each recorded step, computed from `Steps`, and the history of the step.

The *history* of a step is what is known besides state and command before its command acts, a row of 2n + m + 1 + q
numbers: error, requested command and state of the step before in the same deployment, the number of steps recorded
before it, and the q context inputs. The first 2n + m are normalised by half ranges, and states and commands are
measured from the middle of the range; they are zero for the first step of a deployment. Context inputs are those of the
step itself, as its touchdown finds them; until then, those of the step before.
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
        history: History of each step; shape (N, 2n + m + 1 + q). None: only the order of the steps is known.
        phase: Phase at which each step started [rad], NaN where it is unknown; shape (N,). None: all are unknown.
        deployment: Number of the deployment of each step; shape (N,). None: all belong to one.
        number: Number of each step in its deployment; shape (N,). None: they are consecutive, from 0.

    Raises:
        ValueError: A wrong shape, or a number that is not finite.
    """

    space: StepSpace
    state: Array
    command: Array
    error: Array
    history: Array | None = None
    phase: Array | None = None
    deployment: Labels | None = None
    number: Labels | None = None

    def __post_init__(self) -> None:
        state, command = self.space.state_names, self.space.command_names
        _check_rows(self.state, "state", state)
        _check_rows(self.command, "command", command)
        _check_rows(self.error, "error", state)
        if self.history is not None:
            errors = (f"error of {name}" for name in state)
            inputs = (each.name for each in self.space.context_inputs)
            _check_rows(self.history, "history", (*errors, *command, *state, "steps before", *inputs))
        parts = (self.state, self.command, self.error, self.history, self.phase, self.deployment, self.number)
        sizes = [len(part) for part in parts if part is not None]
        if len(set(sizes)) != 1:
            names = "states, commands, errors, histories, phases, deployments and numbers"
            raise ValueError(f"{names} must have one length, not {sizes}")

    def __len__(self) -> int:
        return len(self.state)

    def selected(self, rows: Labels | NDArray[np.bool_]) -> "Observations":
        """Returns the observations in some rows, given by ascending indices or by a mask (N,)."""
        optional = ("history", "phase", "deployment", "number")
        known = {name: part[rows] for name in optional if (part := getattr(self, name)) is not None}
        return Observations(self.space, self.state[rows], self.command[rows], self.error[rows], **known)

    @property
    def labels(self) -> Labels:
        """Deployment and number of each step; shape (N, 2)."""
        deployment = np.zeros(len(self), np.intp) if self.deployment is None else self.deployment
        number = np.arange(len(self)) if self.number is None else self.number
        return np.stack([deployment, number], axis=1)

    @property
    def context_inputs(self) -> int:
        """Number of context inputs that the history has, q."""
        return 0 if self.history is None else len(self.space.context_inputs)

    def points(self, history_inputs: HistoryInputs) -> Array:
        """State, command and history inputs; shape (N, n + m + c)."""
        n, m = len(self.space.state), len(self.space.command)
        history = self.history
        if history is None:
            if history_inputs.lagged_inputs != "none" or history_inputs.context_inputs:
                raise ValueError(
                    f"lagged inputs {history_inputs.lagged_inputs!r} need the history of the steps; observe a log"
                )
            history = np.arange(float(len(self)))[:, None] * np.eye(2 * n + m + 1)[-1]
        return np.hstack([self.state, self.command, history_inputs.of(history, n)])

    def training_data(self, history_inputs: HistoryInputs, coordinate: int) -> TrainingData:
        """Training data of the regression of one state coordinate."""
        space, points = self.space, self.points(history_inputs)
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
    n, m = len(space.state), len(space.command)
    history = np.empty((0, 2 * n + m + 1 + len(space.context_inputs)))
    return Observations(space, np.empty((0, n)), np.empty((0, m)), np.empty((0, n)), history)


def observe(log: Steps, nominal: StepMap) -> Observations:
    """Computes the nominal map's error at the steps of a log that ended at their section, at the commands requested.

    What limits remove from a command is thus a part of the error. A step that fails on the nominal map has no error and
    is omitted, and so are steps whose states are doubtful.
    """
    error = log.next_state - nominal.evaluate(log.state, log.requested).next_state
    lagged = _lagged_quantities(nominal.space, error, log.requested, log.state)
    before = np.where(log.follows[:, None], np.roll(lagged, 1, axis=0), 0.0)
    history = np.hstack([before, np.arange(float(len(log)))[:, None], _context_inputs(nominal.space, log)])
    known = np.isfinite(error).all(axis=1) & ~log.doubtful
    rows = log.state[known], log.requested[known], error[known], history[known], log.phase[known]
    return Observations(nominal.space, *rows, log.iteration[known], log.number[known])


def next_history(log: Steps, nominal: StepMap, iteration: int) -> Array:
    """History of the step that follows a log; shape (2n + m + 1 + q,).

    Args:
        log: All earlier steps.
        nominal: The nominal map.
        iteration: Deployment that the step belongs to.
    """
    last = log.last
    if last is None or last.iteration != iteration:
        nothing = np.zeros(2 * len(log.space.state) + len(log.space.command))
        return np.concatenate([nothing, [len(log)], np.zeros(len(nominal.space.context_inputs))])
    return history_after(last.record, error_of(last.record, nominal), nominal.space, len(log))


def history_after(record: StepRecord, error: Array, space: StepSpace, steps: int) -> Array:
    """History of the step that follows another one; shape (2n + m + 1 + q,).

    Args:
        record: The step before.
        error: The nominal map's error at it; shape (n,).
        space: Step space of both.
        steps: Number of steps recorded, including the one before.
    """
    lagged = _lagged_quantities(space, error, record.requested, record.state)
    return np.concatenate([lagged, [steps], context_inputs_of(record.context, space)])


def context_inputs_of(context: Mapping[str, float], space: StepSpace) -> Array:
    """Context inputs of a step in units of their scales, zero where one is unknown; shape (q,)."""
    found = [context.get(each.name, 0.0) / each.input_scale for each in space.context_inputs]
    return np.nan_to_num(np.array(found, float))


def _context_inputs(space: StepSpace, log: Steps) -> Array:
    """Context inputs of all steps of a log; shape (N, q)."""
    found, names = np.zeros((len(log), len(space.context_inputs))), log.space.context_names
    for column, each in enumerate(space.context_inputs):
        if each.name in names:
            found[:, column] = np.nan_to_num(log.context[:, names.index(each.name)] / each.input_scale)
    return found


def error_of(record: StepRecord, nominal: StepMap) -> Array:
    """Actual − nominal next state of one step, NaN where one of them is missing; shape (n,)."""
    return record.next_state - nominal.evaluate(record.state, record.requested).next_state


def _lagged_quantities(space: StepSpace, error: Array, command: Array, state: Array) -> Array:
    """Part of the next step's history that describes this step; shape (…, 2n + m). An unknown error is zero."""
    parts = [np.nan_to_num(error) / space.state_scale, space.point_of(command), space.scaled_state(state)]
    return np.concatenate(parts, axis=-1)


def _check_rows(array: Array, name: str, columns: tuple[str, ...]) -> None:
    if np.ndim(array) != 2 or np.shape(array)[1] != len(columns):
        raise ValueError(f"{name} must have the columns {', '.join(columns)}, not the shape {np.shape(array)}")
    if not np.isfinite(array).all():
        row = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name} must be finite, but row {row} is {array[row].tolist()}; leave failed steps out")
