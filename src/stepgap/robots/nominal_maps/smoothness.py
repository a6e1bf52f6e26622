"""Whether differences of a map approximate its derivatives: those of a simulator with contacts may be noise.

The error of a central difference is the sum of a part that grows with the step (curvature) and one that decreases
(round-off, or jumps where a contact is detected one time step later). So the derivatives with two sizes of step agree
only between the two. They may also agree if both are so small that they are between two jumps, where the derivatives
have nothing to do with those of the whole; hence steps are tried from the largest one down.
"""

from itertools import pairwise

import numpy as np

from stepgap.step import Array, StepMap, difference_jacobian

STEPS = tuple(np.geomspace(1e-4, 0.1, 7).tolist())
"""Sizes of steps that are tried, in half ranges; each is 3.2 times as large as the one before."""

AGREEMENT = 0.1
"""Jacobians with two sizes of step agree if at half of the points they differ by at most this part of their size."""

NEGLIGIBLE = 0.1
"""Part of the norm of a Jacobian below which the norm of one of its columns counts as zero."""


def suitable_step(step_map: StepMap, rng: np.random.Generator, count: int = 12) -> float | None:
    """Smallest step of `STEPS` whose Jacobians agree with those of the next smaller one, as those of larger ones do.

    Args:
        step_map: The map.
        rng: Chooses the points within the ranges of use.
        count: Number of points.

    Returns:
        A step in half ranges, for `difference_jacobian`. None means that the map is not smooth, or that nearly all of
        its steps fail.
    """
    space = step_map.space
    states = space.state_centre + space.state_scale * rng.uniform(-0.8, 0.8, (count, len(space.state)))
    commands = space.command_at(rng.uniform(-0.8, 0.8, (count, len(space.command))))
    found, jacobians = None, _scaled_jacobians(step_map, states, commands, STEPS[-1])
    for step, smaller in pairwise(reversed(STEPS)):
        finer = _scaled_jacobians(step_map, states, commands, smaller)
        known = _disagreement(jacobians, finer)
        if len(known) < count / 2 or np.median(known) > AGREEMENT:
            break
        found, jacobians = step, finer
    return found


def _disagreement(jacobians: Array, finer: Array) -> Array:
    """Largest relative difference of a column of the two Jacobians, at each point where both are finite; (k,)."""
    both = np.isfinite(jacobians + finer).all(axis=(1, 2))
    jacobians, finer = jacobians[both], finer[both]
    size = np.linalg.norm(jacobians, axis=1)
    small = NEGLIGIBLE * np.linalg.norm(jacobians, axis=(1, 2))[:, None]
    return np.max(np.linalg.norm(jacobians - finer, axis=1) / np.maximum(size, np.maximum(small, 1e-300)), axis=1)


def _scaled_jacobians(step_map: StepMap, states: Array, commands: Array, step: float) -> Array:
    """Jacobians in half ranges; shape (count, n, n + m)."""
    space = step_map.space
    inputs = np.concatenate([space.state_scale, space.command_scale])
    return difference_jacobian(step_map, states, commands, step) * inputs / space.state_scale[:, None]
