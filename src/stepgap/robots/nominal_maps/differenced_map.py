"""A map without a formula for its derivatives: differences with a step that suits it."""

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.robots.nominal_maps.smoothness import STEPS, suitable_step
from stepgap.step import Array, Outcome, StepMap, StepSpace, difference_jacobian

MOST_EVALUATIONS = 400
"""Number of evaluations for the choice of a step, unless the number of coordinates requires more."""

COMPARED_POINTS = 3, 12
"""Smallest and largest number of points at which Jacobians are compared."""


@final
@dataclass(frozen=True, eq=False)
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
