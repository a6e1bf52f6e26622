"""Weights that an experiment gives to state coordinates."""

from collections.abc import Mapping
from dataclasses import replace
from math import inf

from stepgap.base.ranges import require
from stepgap.step import StepSpace


def weighted_space(space: StepSpace, weights: Mapping[str, float]) -> StepSpace:
    """The space with other weights of the named state coordinates.

    Raises:
        ValueError: A name is not one of the state, a weight is negative or not finite, or all are 0.
    """
    if not weights:
        return space
    names = ", ".join(space.state_names)
    for name, weight in weights.items():
        require(name in space.state_names, f"weights.{name}", weight, f"have the name of a state coordinate: {names}")
        require(0 <= weight < inf, f"weights.{name}", weight, "be a finite number from 0 on")
    state = tuple(replace(each, weight=weights.get(each.name, each.weight)) for each in space.state)
    tracked = any(each.weight for each in state)
    require(tracked, "weights", dict(weights), f"leave a weight above 0 of at least one of {names}")
    return replace(space, state=state)
