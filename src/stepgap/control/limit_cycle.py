"""Limit cycles, their stability, and the one-step reachable set (Sec. 4.2 of the paper); targets that can be held.

The fixed points of a map with m commands usually form a set of m dimensions among all states. A box of ranges is no
picture of it, so the middle of the ranges, and stairs about it, may be far from any gait. Instead of a target that
cannot be held, `nearest_fixed_point` finds the state nearest to it that some command repeats.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from stepgap.base.ranges import require
from stepgap.control.bounded_search import bounded_solution
from stepgap.control.box_points import box_grid, box_points
from stepgap.control.gauss_newton import minimise
from stepgap.control.reach import repeated_state, whole_states, within_noise
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController, as_vector
from stepgap.step import Array, Codes, StepFailed, StepMap, StepStatus

PULL: Final = 0.03
"""Weight of the distance from a target, against that of the change of state, while a fixed point near it is sought."""


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A state, a command and the next state that follows: a limit cycle if the state is held.

    Attributes:
        state: X₀; shape (n,).
        command: U₀; shape (m,).
        next_state: map(X₀, U₀), equal to X₀ if held, else the closest to it; shape (n,).
        wanted: Which coordinates of X₀ are targets, and not only completed; shape (n,).
        held: Whether the next state is the state, up to the noise of one step in each coordinate.
        distance: From `state` to `next_state` in half ranges, Euclidean.
        floquet_multipliers: Eigenvalues of the Poincaré map's derivative ∂next/∂state at the fixed command, the largest
            first; NaN where a failing step nearby leaves no Jacobian. They are Floquet multipliers only if the state is
            held. Shape (n,), complex.
    """

    state: Array
    command: Array
    next_state: Array
    wanted: NDArray[np.bool_]
    held: bool
    distance: float
    floquet_multipliers: NDArray[np.complex128]

    @property
    def stable(self) -> bool:
        """Whether the state is held and small errors of it decay while the command stays the same."""
        return self.held and bool((np.abs(self.floquet_multipliers) < 1).all())


@dataclass(frozen=True, eq=False)
class ReachableSet:
    """One-step reachable set: the next states from one state, for commands all over the bounds.

    Attributes:
        commands: On an even grid of one or two commands, (s, …, m) with one axis for each; otherwise (k, m).
        next_states: NaN where the step fails; shape (…, n).
        statuses: `StepStatus` values; shape (…).
    """

    commands: Array
    next_states: Array
    statuses: Codes

    @property
    def boundary(self) -> Array:
        """Next states along the border of the command bounds, counter-clockwise in the commands and not closed.

        They enclose the reachable set where the map folds nowhere and no step fails; failing steps are NaN, which
        interrupts a plotted line. Shape (4 (s - 1), n).

        Raises:
            ValueError: There are not two commands, so the border is no polygon.
        """
        grid = self.next_states
        commands = self.commands.shape[-1]
        if commands != 2:
            raise ValueError(f"the border is a polygon for two commands, not for {commands}")
        return np.concatenate([grid[:-1, 0], grid[-1, :-1], grid[:0:-1, -1], grid[0, :0:-1]])


def fixed_point(step_map: StepMap, target: ArrayLike, guess: ArrayLike | None = None) -> FixedPoint:
    """Finds the command that holds a state, X₀ = map(X₀, U₀), or whose next state is closest to it.

    Args:
        step_map: The map.
        target: The state X₀ to hold, completed by `whole_states` in coordinates without a target; shape (n,).
        guess: Command to start from; shape (m,).

    Raises:
        StepFailed: From this state no command that was searched makes a step.
    """
    target = as_vector("target", target, len(step_map.space.state))
    (state,) = whole_states(step_map, target[None])
    plan = StepController(step_map)(state, state, guess)
    return FixedPoint(
        state,
        plan.command,
        plan.predicted,
        step_map.space.has_target(target),
        bool(within_noise(step_map, state, plan.predicted)),
        plan.distance,
        floquet_multipliers(step_map, state, plan.command),
    )


def floquet_multipliers(step_map: StepMap, state: ArrayLike, command: ArrayLike) -> NDArray[np.complex128]:
    """Eigenvalues of ∂next/∂state at a fixed command, the largest first; shape (n,), NaN where there is no Jacobian."""
    n = len(step_map.space.state)
    matrix = step_map.jacobian(state, command)[:, :n]
    if not np.isfinite(matrix).all():
        return np.full(n, complex(np.nan, np.nan))
    values = np.linalg.eigvals(matrix).astype(complex)
    return values[np.argsort(-np.abs(values), kind="stable")]


def reachable_set(step_map: StepMap, state: ArrayLike, samples: int = 21) -> ReachableSet:
    """Computes the one-step reachable set: next states from one state, for commands all over the bounds.

    Args:
        step_map: The map.
        state: Shape (n,).
        samples: Grid points for each of one or two commands, at least 2; of more commands, the square of this number is
            tried.
    """
    require(samples >= 2, "samples", samples, "be at least 2: both ends of each command")
    space = step_map.space
    state = as_vector("state", state, len(space.state))
    m = len(space.command)
    commands = space.command_at(box_grid(samples, m) if m <= 2 else box_points(samples**2, m))
    next_states, statuses = step_map.evaluate(state, commands)
    return ReachableSet(commands, np.where((statuses == StepStatus.OK)[..., None], next_states, np.nan), statuses)


def reached_in_one_step(step_map: StepMap, states: Array, targets: Array) -> NDArray[np.bool_]:
    """Whether some command leads from each state (k, n) to its target (k, n), NaN where there is none; shape (k,)."""
    controller = StepController(step_map)
    reached = np.zeros(len(states), bool)
    for row, (state, target) in enumerate(zip(states, targets, strict=True)):
        try:
            plan = controller(state, target)
        except StepFailed:
            continue
        reached[row] = plan.reached or within_noise(step_map, target, plan.predicted)
    return reached


def nearest_fixed_point(step_map: StepMap, target: Array) -> Array:
    """The state in the ranges of use, near a target, that some command changes least; shape (n,).

    First the change of state and, with a small weight, the distance from the target are made small together, then the
    change alone, from there.

    Args:
        step_map: The map.
        target: NaN in coordinates without a target; shape (n,).
    """
    space = step_map.space
    n = len(space.state)
    targeted = np.flatnonzero(space.has_target(target))
    change = repeated_state(step_map, space.state_centre, np.arange(n))
    start = np.zeros(change.size)
    start[targeted] = space.scaled_state(target)[targeted]
    pull = PULL * np.eye(change.size)[targeted]

    def pulled(point: Array) -> Array:
        return np.concatenate([change.function(point), PULL * (point - start)[..., targeted]], axis=-1)

    near = bounded_solution(pulled, lambda point: np.vstack([change.jacobian(point), pull]), start)
    return change.state_at(minimise(change.function, change.jacobian, near.point).point)


def held_reference(step_map: StepMap, reference: Reference) -> Reference | None:
    """The reference with each target that the map does not hold replaced by one near it that it holds.

    Args:
        step_map: The map.
        reference: Targets in all state coordinates (`Reference.of`).

    Returns:
        The same object if all targets are held; None if no fixed point was found near any.
    """
    first, number = reference.distinct
    targets = reference.targets[first].copy()
    held = _are_held(step_map, targets)
    if held.all():
        return reference
    for row in np.flatnonzero(~held):
        state = nearest_fixed_point(step_map, targets[row])
        targeted = step_map.space.has_target(targets[row])
        targets[row, targeted] = state[targeted]
    held = _are_held(step_map, targets)
    if not held.any():
        return None
    targeted = step_map.space.has_target(targets)
    for row in np.flatnonzero(~held):  # the nearest of the others takes its place
        alike = held & (targeted == targeted[row]).all(axis=1)
        if not alike.any():
            return None
        away = (targets[alike] - reference.targets[first[row]]) / step_map.space.error_scale
        targets[row] = targets[alike][np.argmin(np.nansum(away[:, targeted[row]] ** 2, axis=1))]
    return Reference(reference.names, targets[number])


def _are_held(step_map: StepMap, targets: Array) -> np.ndarray:
    return reached_in_one_step(step_map, whole_states(step_map, targets), targets)
