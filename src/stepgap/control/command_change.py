"""A limit of the change of the command from one step to the next: narrower bounds of the next command."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array, Outcome, StepMap, StepSpace


@final
@dataclass(frozen=True, eq=False)
class CommandChange:
    """How much commands may differ from the one before them.

    Attributes:
        largest: Largest change of each command in a step, as a share of its range; 1 for no limit.
        previous: Command of the step before; shape (m,). None before the first step, whose command has no limit.
    """

    largest: float = 1.0
    previous: Array | None = None

    def bounds(self, space: StepSpace, steps: int = 1) -> StepSpace:
        """The space with the bounds of the command that is the first, second, … after the previous one."""
        if self.previous is None or steps * self.largest >= 1:  # every command is within reach
            return space
        change = 2 * steps * self.largest * space.command_scale
        previous = np.clip(self.previous, space.command_lower, space.command_upper)
        lower = np.maximum(space.command_lower, previous - change).tolist()
        upper = np.minimum(space.command_upper, previous + change).tolist()
        sides = zip(space.command, lower, upper, strict=True)
        return replace(space, command=tuple(replace(each, lower=low, upper=high) for each, low, high in sides))

    def limited(self, step_map: StepMap) -> StepMap:
        """The map with the bounds of the next command."""
        space = step_map.space
        bounds = self.bounds(space)
        return step_map if bounds is space else MapInSpace(step_map, bounds)

    def after(self, command: Array) -> "CommandChange":
        """The limit after a step with this command."""
        return replace(self, previous=command)


NO_LIMIT = CommandChange()
"""Any command may follow any other."""


@final
@dataclass(frozen=True, eq=False)
class MapInSpace(StepMap):
    """A map with other bounds of the commands, or other weights of the state; it predicts the same.

    Attributes:
        inner: The map.
        quantities: Names, units and ranges.
    """

    inner: StepMap
    quantities: StepSpace

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes of the map."""
        return self.inner.evaluate(state, command)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m)."""
        return self.inner.jacobian(state, command)

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value; shape (n,)."""
        return self.inner.noise_std

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state; shape (…, n) [state units]."""
        return self.inner.std(state, command)

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n, n + m)."""
        return self.inner.std_gradient(state, command)
