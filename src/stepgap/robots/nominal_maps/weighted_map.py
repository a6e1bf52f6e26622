"""A nominal map whose state coordinates have other weights; it predicts the same."""

from dataclasses import dataclass, replace
from typing import final

from numpy.typing import ArrayLike

from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap
from stepgap.step import Array, Outcome, StepMap, StepSpace


def with_space(step_map: StepMap, space: StepSpace) -> StepMap:
    """The map with another space, of which only the weights may differ; a map that has a formula keeps its type."""
    if space == step_map.space:
        return step_map
    if isinstance(step_map, AffineMap | SurrogateMap):
        return replace(step_map, quantities=space)
    return _WeightedMap(step_map, space)


@final
@dataclass(frozen=True, eq=False)
class _WeightedMap(StepMap):
    inner: StepMap
    quantities: StepSpace

    @property
    def space(self) -> StepSpace:
        return self.quantities

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        return self.inner.evaluate(state, command)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        return self.inner.jacobian(state, command)
