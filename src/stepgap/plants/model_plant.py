"""A plant that is a `StepMap` with noise, for fast tests and for experiments without a rig."""

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.ranges import require
from stepgap.plants.plant import RepeatablePlant
from stepgap.step import Array, StepMap, StepRecord, StepSpace, StepStatus


class ModelPlant(RepeatablePlant):
    """Executes steps by evaluating a map and adding noise.

    Args:
        step_map: True map of the plant.
        start_state: First state at the section; shape (n,). [default: the middle of the ranges of use]
        noise: Standard deviation of the noise that is added to every next state; shape (n,). [default: none]
        rng: Random generator that draws the noise; without noise, none is needed.

    Raises:
        ValueError: There is noise, but no generator.
    """

    def __init__(
        self,
        step_map: StepMap,
        start_state: ArrayLike | None = None,
        noise: ArrayLike = 0.0,
        rng: np.random.Generator | None = None,
    ):
        start = step_map.space.state_centre if start_state is None else start_state
        self._map = step_map
        self._start = np.asarray(start, float)
        self._noise = np.broadcast_to(np.asarray(noise, float), self._start.shape)
        require(rng is not None or not self._noise.any(), "noise", noise, "come with a generator that draws it")
        self._rng = rng or np.random.default_rng(0)  # without noise, what it draws is multiplied by 0
        self._state = self._start

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the map."""
        return self._map.space

    def start(self) -> Array:
        """Sets and returns the start state."""
        self._state = self._start
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Evaluates the map at the command, limited to its bounds."""
        record = self._step(np.asarray(command, float), self._rng)
        self._state = record.next_state
        return record

    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:  # noqa: ARG002
        """Next state with new noise; a map has no world that could be turned."""
        return self._step(np.asarray(command, float), rng).next_state

    def _step(self, command: Array, rng: np.random.Generator) -> StepRecord:
        """Record of a step from the present state, which stays as it is.

        A requested command lies within its bounds, and nothing else limits it, so requested and applied are the same.
        The noise is that of the motion, not of a sensor: the true next state has it, too.
        """
        within_bounds = np.clip(command, self.space.command_lower, self.space.command_upper)
        predicted, code = self._map.evaluate(self._state, within_bounds)
        next_state = predicted + rng.normal(0.0, self._noise)
        return StepRecord(
            state=self._state,
            command=command,
            applied=within_bounds,
            next_state=next_state,
            status=StepStatus(int(code)),
            requested=within_bounds,
            true_next_state=next_state,
        )

    def stop(self) -> None:
        """Does nothing: nothing moves."""
