"""Steps in which the command of the step before still acts: it becomes a part of the state, which plans then see.

A policy follows its commanded velocity with a lag. Who wants the mean velocity of the next step to be right, and no
more, commands too much, so that the step ends too fast, and has to undo it in the step after. Where
y = a y₁ + b₀ c + b₁ c₁, with the command before c₁, the command that makes each y right answers an error by (−b₁/b₀)ᵏ
after k steps: if b₁ is larger than b₀, it grows up to its bounds. With c₁ as a coordinate of the state that is not
tracked, the errors of all later steps count (`goal.Deviation`), and such a loop does not ring.
"""

from dataclasses import dataclass, replace
from typing import Final, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array, CommandBefore, Outcome, StepMap, StepSpace

COMMAND_WEIGHT: Final = 0.15
"""Weight of the squared deviation [half bounds] of a command from the one that holds the target. With 0.03, commands of
policies at constant targets changed twice as much from step to step, and errors were less by 2 % at most."""


def space_with_command(space: StepSpace) -> StepSpace:
    """The space whose state also has the command of the step before, which is not tracked."""
    more = [replace(quantity, name=f"{quantity.name}_before", weight=0.0) for quantity in space.command]
    return replace(space, state=(*space.state, *more))


@final
@dataclass(frozen=True, eq=False)
class MapWithCommand(StepMap):
    """A map whose state also has the command of the step before: next = (map(state, command), command).

    Attributes:
        inner: The map of the other state coordinates, for one command before.
        quantities: As of `space_with_command`.
        before: That command, and the effect of another one.
        start: State of the inner map at which that effect is none; shape (n,).
    """

    inner: StepMap
    quantities: StepSpace
    before: CommandBefore
    start: Array

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes."""
        state, earlier = self._parts(state)
        next_state, status = self.inner.evaluate(state, command)
        of_command = (earlier - self.before.command) @ self.before.effect.T
        next_state = next_state + of_command + (state - self.start) @ self.before.memory.T
        return Outcome(_side_by_side(next_state, command), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n + m, n + 2m)."""
        n, m = self.before.effect.shape
        whole = self._spread_out(self.inner.jacobian(self._parts(state)[0], command))
        whole[..., :n, :n] += self.before.memory
        whole[..., :n, n : n + m] = self.before.effect
        whole[..., n:, n + m :] = np.eye(m)
        return whole

    @property
    def noise_std(self) -> Array:
        """Standard deviation of a measured next state about its expected value; shape (n + m,)."""
        return _side_by_side(self.inner.noise_std, np.zeros(len(self.space.command)))

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the next state; shape (…, n + m)."""
        return _side_by_side(self.inner.std(self._parts(state)[0], command), np.zeros(len(self.space.command)))

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂std/∂(state, command); shape (…, n + m, n + 2m)."""
        return self._spread_out(self.inner.std_gradient(self._parts(state)[0], command))

    def _parts(self, state: ArrayLike) -> tuple[Array, Array]:
        """State of the map (…, n), and command before (…, m)."""
        n = len(self.before.effect)
        state = np.asarray(state, float)
        return state[..., :n], state[..., n:]

    def _spread_out(self, derivatives: Array) -> Array:
        """Derivatives by state and command (…, n, n + m) as those by the whole state: zero by the command before."""
        n, m = self.before.effect.shape
        whole = np.zeros((*derivatives.shape[:-2], n + m, n + 2 * m))
        whole[..., :n, :n] = derivatives[..., :n]
        whole[..., :n, n + m :] = derivatives[..., n:]
        return whole


@final
@dataclass(frozen=True, eq=False)
class StandingMap(StepMap):
    """The step of a robot whose command was the same in the step before: state and command alone.

    Attributes:
        whole: A map whose state also has the command of the step before.
        quantities: State and command without it.
    """

    whole: StepMap
    quantities: StepSpace

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes."""
        next_state, status = self.whole.evaluate(_side_by_side(state, command), command)
        return Outcome(next_state[..., : len(self.quantities.state)], status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(next state)/∂(state, command); shape (…, n, n + m)."""
        n = len(self.quantities.state)
        m = len(self.quantities.command)
        whole = self.whole.jacobian(_side_by_side(state, command), command)[..., :n, :]
        return np.concatenate([whole[..., :n], whole[..., n : n + m] + whole[..., n + m :]], axis=-1)


def _side_by_side(state: ArrayLike, command: ArrayLike) -> Array:
    """States (…, n) and commands (…, m) side by side."""
    parts = np.asarray(state, float), np.asarray(command, float)
    leading = np.broadcast_shapes(*(part.shape[:-1] for part in parts))
    return np.concatenate([np.broadcast_to(part, (*leading, part.shape[-1])) for part in parts], axis=-1)
