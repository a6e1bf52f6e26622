"""Maps around another map: with other bounds of the commands, or with a budget of steps that they may evaluate."""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array, CommandBefore, Outcome, StepMap, StepSpace, StepStatus


@dataclass(frozen=True, eq=False, repr=False)
class WrappedMap(StepMap):
    """A map with the uncertainty of another one; a subclass defines `space`, `evaluate` and `jacobian`.

    Attributes:
        inner: The other map.
    """

    inner: StepMap

    @property
    def command_before(self) -> CommandBefore | None:
        """The effect of the command of the step before; None if it has none, or is not known."""
        return self.inner.command_before

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


@final
@dataclass(frozen=True, eq=False)
class MapInSpace(WrappedMap):
    """A map with other bounds of the commands, or other weights of the state; it predicts the same.

    Attributes:
        quantities: Names, units and ranges.
    """

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


LEAST_ROOM: Final = 1e-6  # Width of the narrowest bounds of a command [half bounds]


@final
@dataclass(frozen=True, eq=False)
class CommandChange:
    """How much commands may differ from the one before them: narrower bounds of the next command.

    Attributes:
        largest: Largest change of each command in a step, as a share of its range; 1 for no limit.
        previous: Command of the step before; shape (m,). None before the first step, whose command has no limit.
        around: Least and largest command beside that, which give way where both cannot be; each (m,). None: no others.
    """

    largest: float = 1.0
    previous: Array | None = None
    around: tuple[Array, Array] | None = None

    def bounds(self, space: StepSpace, steps: int = 1) -> StepSpace:
        """The space with the bounds of the command that is the first, second, … after the previous one."""
        lower = space.command_lower
        upper = space.command_upper
        any_change = self.previous is None or steps * self.largest >= 1  # every command is within reach
        if any_change and self.around is None:
            return space
        if self.previous is not None and not any_change:
            change = 2 * steps * self.largest * space.command_scale
            previous = np.clip(self.previous, lower, upper)
            lower = np.maximum(lower, previous - change)
            upper = np.minimum(upper, previous + change)
        if self.around is not None:
            least = LEAST_ROOM * space.command_scale
            lower = np.clip(self.around[0], lower, upper - least)
            upper = np.clip(self.around[1], lower + least, upper)
        sides = zip(space.command, lower.tolist(), upper.tolist(), strict=True)
        return replace(space, command=tuple(replace(quantity, lower=low, upper=high) for quantity, low, high in sides))

    def limited(self, step_map: StepMap) -> StepMap:
        """The map with the bounds of the next command."""
        space = step_map.space
        bounds = self.bounds(space)
        return step_map if bounds is space else MapInSpace(step_map, bounds)

    def after(self, command: Array) -> "CommandChange":
        """The limit after a step with this command."""
        return replace(self, previous=command)


NO_LIMIT = CommandChange()  # Any command may follow any other


@dataclass(eq=False)
class EvaluationBudget:
    """Number of steps that the maps of one search may still evaluate together, so that it ends in time on a slow map.

    Attributes:
        remaining: Number of steps.
    """

    remaining: int

    def spend(self, steps: int) -> bool:
        """Takes a number of steps from the budget; returns whether they were in it, and takes none if not."""
        granted = steps <= self.remaining
        self.remaining -= steps if granted else 0
        return granted


@final
@dataclass(frozen=True, eq=False)
class BudgetedMap(WrappedMap):
    """A map whose steps fail once the budget is spent.

    A search treats such a step like any other that fails, and returns the best command found before. A Jacobian counts
    as the 2 (n + m) steps of its central differences, also where there is a formula for it.

    Attributes:
        budget: Number of steps that it may still evaluate.
    """

    budget: EvaluationBudget

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the map."""
        return self.inner.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes; all fail as `StepStatus.INVALID` if they are more than the budget permits."""
        leading = self._leading(state, command)
        if self.budget.spend(int(np.prod(leading))):
            return self.inner.evaluate(state, command)
        n = len(self.space.state)
        return Outcome(np.full((*leading, n), np.nan), np.full(leading, int(StepStatus.INVALID)))

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m). NaN where a step fails or the budget is spent."""
        leading = self._leading(state, command)
        n = len(self.space.state)
        inputs = n + len(self.space.command)
        if self.budget.spend(2 * inputs * int(np.prod(leading))):
            return self.inner.jacobian(state, command)
        return np.full((*leading, n, inputs), np.nan)

    @staticmethod
    def _leading(state: ArrayLike, command: ArrayLike) -> tuple[int, ...]:
        """Shape of the batch."""
        return np.broadcast_shapes(np.shape(state)[:-1], np.shape(command)[:-1])
