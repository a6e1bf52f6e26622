"""What commands can do: which targets one step reaches, in how many independent directions, and after how many steps.

A target is *reached* if some command within the bounds leads to it, up to the noise of one step in each coordinate. It
is *held* if it is reached from itself. All that StepGap says of targets uses this one notion. Where a target wants
nothing in some coordinates, they are found: those of a state that some command repeats.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.control.bounded_search import bounded_solution
from stepgap.control.box_points import composite_design
from stepgap.control.gauss_newton import REACHED, Function, Jacobian
from stepgap.control.reference import Indices
from stepgap.step import Array, StepMap, StepSpace

SMALL_PART: Final = 0.01
"""Part of half a range of use that counts as a change of a coordinate whose noise is not known."""


def within_noise(step_map: StepMap, target: Array, next_state: Array) -> NDArray[np.bool_]:
    """Whether next states are targets, up to the noise of one step in each coordinate; (…, n) and (…, n) to (…)."""
    limit = np.maximum(step_map.noise_std, REACHED * step_map.space.state_scale)
    return np.all((np.abs(next_state - target) <= limit) | ~step_map.space.has_target(target), axis=-1)


def reach_from(step_map: StepMap, state: Array) -> tuple[Array, Array]:
    """Least and largest value of each coordinate of the next state with commands at ends and corners of the bounds.

    Args:
        step_map: The map.
        state: State at the start; shape (n,).

    Returns:
        Two arrays of shape (n,); infinite, the least above the largest, where no command makes a step.
    """
    space = step_map.space
    next_states = step_map.evaluate(state, space.command_at(composite_design(len(space.command)))).next_state
    unknown = np.isnan(next_states)
    return np.where(unknown, np.inf, next_states).min(axis=0), np.where(unknown, -np.inf, next_states).max(axis=0)


def whole_states(step_map: StepMap, targets: Array) -> Array:
    """Targets (k, n) completed to states, each as near as possible to one that some command repeats; shape (k, n).

    The coordinates without a target are searched within their ranges of use, from the middle of them.
    """
    has_target = step_map.space.has_target
    whole = [target if has_target(target).all() else whole_state(step_map, target)[0] for target in targets]
    return np.array(whole).reshape(targets.shape)


def whole_state(step_map: StepMap, target: Array) -> tuple[Array, Array]:
    """A target (n,) completed in the coordinates without one, by a zero of next state − state; and its command (m,)."""
    space = step_map.space
    targeted = space.has_target(target)
    free = np.flatnonzero(~targeted)
    change = repeated_state(step_map, np.where(targeted, target, space.state_centre), free)
    point = bounded_solution(change.function, change.jacobian, np.zeros(change.size)).point
    return change.state_at(point), space.command_at(point[len(free) :])


@dataclass(frozen=True, eq=False)
class RepeatedState:
    """The change of state by a step, as a function of which a zero is sought: a state that a command repeats.

    Attributes:
        function: (next state − state) / half range of use; points (…, k) to values (…, n).
        jacobian: Its derivative at one point; shape (n, k).
        state_at: States of points, whose first coordinates are free state coordinates [half ranges] and the others the
            command, scaled; (…, k) to (…, n).
        size: Number of coordinates of a point, k.
    """

    function: Function
    jacobian: Jacobian
    state_at: Function
    size: int


def repeated_state(step_map: StepMap, base: Array, free: Indices) -> RepeatedState:
    """The change of state by a step from states that differ from another one in some coordinates.

    Args:
        step_map: The map.
        base: The state at the point 0; shape (n,).
        free: Numbers of the coordinates that vary.
    """
    space = step_map.space
    n = len(space.state)
    scale = space.state_scale
    columns = np.r_[free, n : n + len(space.command)]
    by_point = np.concatenate([scale[free], space.command_scale])

    def state_at(point: Array) -> Array:
        state = np.broadcast_to(base, (*point.shape[:-1], n)).copy()
        state[..., free] += point[..., : len(free)] * scale[free]
        return state

    def change(point: Array) -> Array:
        state = state_at(point)
        return (step_map.evaluate(state, space.command_at(point[..., len(free) :])).next_state - state) / scale

    def jacobian(point: Array) -> Array:
        matrix = step_map.jacobian(state_at(point), space.command_at(point[len(free) :])) - np.eye(
            n, n + len(space.command)
        )
        return matrix[:, columns] * by_point / scale[:, None]

    return RepeatedState(change, jacobian, state_at, len(columns))


@dataclass(frozen=True, eq=False)
class CommandEffect:
    """How far the commands move the next states, to first order.

    Attributes:
        sizes: Lengths of the axes of the ellipsoid that the commands between their bounds fill in the tracked
            coordinates, the largest first (singular values), in units of the state that the caller chose.
        delays: Number of steps until a command moves each coordinate by at least one unit, 1 for the next state; 0 if
            it does not within n steps; shape (n,).
    """

    sizes: Array
    delays: NDArray[np.int64]

    @property
    def rank(self) -> int:
        """Number of independent directions in which the commands move what is tracked by at least one unit."""
        return int(np.count_nonzero(self.sizes >= 1))


def command_effect(space: StepSpace, jacobian: Array, unit: Array) -> CommandEffect:
    """Computes the effect of the commands from the derivatives of the next state.

    Args:
        space: State and command.
        jacobian: ∂(next state)/∂(state, command); shape (n, n + m).
        unit: What counts as a change of each coordinate, such as its noise; shape (n,).
    """
    n = len(space.state)
    by_state = jacobian[:, :n] * unit / unit[:, None]
    by_command = 2 * jacobian[:, n:] * space.command_scale / unit[:, None]  # from one end of the bounds to the other
    delays = np.zeros(n, np.int64)
    moved = by_command
    for steps in range(1, n + 1):
        moves = np.abs(moved).sum(axis=1) >= 1
        delays[moves & (delays == 0)] = steps
        moved = by_state @ moved
    return CommandEffect(np.asarray(np.linalg.svd(by_command[space.tracked], compute_uv=False), float), delays)
