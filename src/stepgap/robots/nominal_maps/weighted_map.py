"""A nominal map whose state coordinates have other weights."""

from dataclasses import replace

from stepgap.control.wrapped_map import MapInSpace
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.surrogate_map import SurrogateMap
from stepgap.step import StepMap, StepSpace


def with_space(step_map: StepMap, space: StepSpace) -> StepMap:
    """The map with another space, of which only the weights may differ; a map that has a formula keeps its type."""
    if space == step_map.space:
        return step_map
    if isinstance(step_map, AffineMap | SurrogateMap):
        return replace(step_map, quantities=space)
    return MapInSpace(step_map, space)
