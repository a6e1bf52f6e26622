"""A map without a formula for its derivatives: differences with a step that suits it.

Differences of a simulator with contacts may be noise. The error of a central difference is the sum of a part that grows
with the step (curvature) and one that decreases (round-off, or jumps where a contact is detected one time step later).
So the derivatives with two sizes of step agree only between the two. They may also agree if both are so small that they
are between two jumps, where the derivatives have nothing to do with those of the whole; hence steps are tried from the
largest one down.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.step import Array, Outcome, StepMap, StepSpace, difference_jacobian

STEPS = tuple(np.geomspace(1e-4, 0.1, 7).tolist())
"""Sizes of steps that are tried, in half ranges; each is 3.2 times as large as the one before."""

AGREEMENT = 0.1
"""Jacobians with two sizes of step agree if at half of the points they differ by at most this part of their size."""

NEGLIGIBLE = 0.1  # Part of the norm of a Jacobian below which the norm of one of its columns counts as zero

MOST_EVALUATIONS = 400
"""Number of evaluations for the choice of a step, unless the number of coordinates requires more."""

COMPARED_POINTS = 3, 12  # Smallest and largest number of points at which Jacobians are compared


@final
@dataclass(frozen=True, eq=False, repr=False)
class DifferencedMap(StepMap):
    """Another map, whose derivatives are differences with a given step.

    Attributes:
        inner: The map; its own derivatives are not used.
        relative_step: Step of the differences, in half ranges.
    """

    inner: StepMap
    relative_step: float

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges."""
        return self.inner.space

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Next states and status codes of the map."""
        return self.inner.evaluate(state, command)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Central differences; shape (…, n, n + m). NaN where a step fails."""
        return difference_jacobian(self.inner, state, command, self.relative_step)


def has_no_formula(step_map: StepMap) -> bool:
    """Whether the class of a map says `jacobian = difference_jacobian`."""
    return type(step_map).jacobian is difference_jacobian


def with_suitable_step(step_map: StepMap, rng: np.random.Generator) -> tuple[StepMap, str]:
    """The map with differences of the smallest step that suits it (`suitable_step`).

    Args:
        step_map: A map that `has_no_formula`.
        rng: Chooses the points at which Jacobians are compared.

    Returns:
        The map itself if the smallest step suits it, else a `DifferencedMap`; and a clause on its roughness, empty if
        it is smooth.
    """
    inputs = len(step_map.space.state) + len(step_map.space.command)
    count = int(np.clip(MOST_EVALUATIONS // (2 * inputs * len(STEPS)), *COMPARED_POINTS))
    step = suitable_step(step_map, rng, count)
    if step is None:
        why = "is not smooth, or most of its steps fail: its differences with two sizes of step disagree for all sizes"
        return DifferencedMap(step_map, STEPS[-1]), f"{why} ({STEPS[0]:g} to {STEPS[-1]:g} half ranges)"
    if step <= STEPS[1]:  # the Jacobians with the smallest step were compared with these
        return step_map, ""
    rough = f"differences of {STEPS[0]:g} and {step:.2g} half ranges disagree, so those of {step:.2g} are used"
    return DifferencedMap(step_map, step), f"is not smooth on a small scale: {rough}"


def suitable_step(step_map: StepMap, rng: np.random.Generator, count: int = 12) -> float | None:
    """Smallest step of `STEPS` whose Jacobians agree with those of the next smaller one, as those of larger ones do.

    Args:
        rng: Chooses the points within the ranges of use.

    Returns:
        A step in half ranges, for `difference_jacobian`. None means that the map is not smooth, or that nearly all of
        its steps fail.
    """
    space = step_map.space
    states = space.state_centre + space.state_scale * rng.uniform(-0.8, 0.8, (count, len(space.state)))
    commands = space.command_at(rng.uniform(-0.8, 0.8, (count, len(space.command))))
    suitable = None
    jacobians = _scaled_jacobians(step_map, states, commands, STEPS[-1])
    # From the largest step on, as long as the next smaller one agrees at most points that have both Jacobians:
    for step, smaller in pairwise(reversed(STEPS)):
        finer = _scaled_jacobians(step_map, states, commands, smaller)
        disagreement = _disagreement(jacobians, finer)
        if len(disagreement) < count / 2 or np.median(disagreement) > AGREEMENT:
            break
        suitable = step
        jacobians = finer
    return suitable


def _disagreement(jacobians: Array, finer: Array) -> Array:
    """Largest relative difference of a column of the two Jacobians, at each point where both are finite; (k,)."""
    both = np.isfinite(jacobians + finer).all(axis=(1, 2))
    jacobians = jacobians[both]
    finer = finer[both]
    size = np.linalg.norm(jacobians, axis=1)
    small = NEGLIGIBLE * np.linalg.norm(jacobians, axis=(1, 2))[:, None]
    return np.max(np.linalg.norm(jacobians - finer, axis=1) / np.maximum(size, np.maximum(small, 1e-300)), axis=1)


def _scaled_jacobians(step_map: StepMap, states: Array, commands: Array, step: float) -> Array:
    """Jacobians in half ranges; shape (count, n, n + m)."""
    space = step_map.space
    inputs = np.concatenate([space.state_scale, space.command_scale])
    return difference_jacobian(step_map, states, commands, step) * inputs / space.state_scale[:, None]
