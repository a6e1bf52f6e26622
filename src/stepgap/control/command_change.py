"""A limit of the change of the command from one step to the next: narrower bounds of the next command."""

from dataclasses import dataclass, replace
from typing import final

import numpy as np

from stepgap.control.wrapped_map import MapInSpace
from stepgap.step import Array, StepMap, StepSpace


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
