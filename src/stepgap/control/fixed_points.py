"""Targets that can be held: instead of one that cannot, the state nearest to it that some command repeats.

The fixed points of a map with m commands usually form a set of m dimensions among all states. A box of ranges is no
picture of it, so the middle of the ranges, and stairs about it, may be far from any gait.
"""

from typing import Final

import numpy as np

from stepgap.control.bounded_search import solve
from stepgap.control.gauss_newton import minimise
from stepgap.control.reach import reached_in_one_step, repeated_state, whole_states
from stepgap.control.reference import Reference
from stepgap.step import Array, StepMap

PULL: Final = 0.03
"""Weight of the distance from a target, against that of the change of state, while a fixed point near it is sought."""


def nearest_fixed_point(step_map: StepMap, target: Array) -> Array:
    """The state in the ranges of use, near a target, that some command changes least; shape (n,).

    First the change of state and, with a small weight, the distance from the target are made small together, then the
    change alone, from there.

    Args:
        step_map: The map.
        target: NaN in coordinates without a target; shape (n,).
    """
    space = step_map.space
    n, wanted = len(space.state), np.flatnonzero(space.has_target(target))
    change = repeated_state(step_map, space.state_centre, np.arange(n))
    start = np.zeros(change.size)
    start[wanted] = space.scaled_state(target)[wanted]
    pull = PULL * np.eye(change.size)[wanted]

    def pulled(point: Array) -> Array:
        return np.concatenate([change.function(point), PULL * (point - start)[..., wanted]], axis=-1)

    near = solve(pulled, lambda point: np.vstack([change.jacobian(point), pull]), start)
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
        found, wanted = nearest_fixed_point(step_map, targets[row]), step_map.space.has_target(targets[row])
        targets[row, wanted] = found[wanted]
    held = _are_held(step_map, targets)
    if not held.any():
        return None
    wanted = step_map.space.has_target(targets)
    for row in np.flatnonzero(~held):  # the nearest of the others takes its place
        alike = held & (wanted == wanted[row]).all(axis=1)
        if not alike.any():
            return None
        away = (targets[alike] - reference.targets[first[row]]) / step_map.space.error_scale
        targets[row] = targets[alike][np.argmin(np.nansum(away[:, wanted[row]] ** 2, axis=1))]
    return Reference(reference.names, targets[number])


def _are_held(step_map: StepMap, targets: Array) -> np.ndarray:
    return reached_in_one_step(step_map, whole_states(step_map, targets), targets)
