"""Whether measured states have the units of their coordinates: degrees or millimetres lie far outside their ranges."""

from collections.abc import Iterable

import numpy as np

from stepgap.learning.steps import Steps

COMPARED_STEPS = 5
"""Number of steps of a deployment, at most, whose states are compared with the ranges of use."""

FAR_RANGES = 3.0
"""A state is far outside its range of use if it is more than this number of widths of the range away from it."""


def far_states(steps: Steps) -> Iterable[str]:
    """A sentence for each state coordinate that is far outside its range of use.

    A coordinate is reported if the median of its distance from its range of use, over the first `COMPARED_STEPS` steps,
    is more than `FAR_RANGES` widths of that range. A robot that works hardly ever is, but degrees, millimetres or
    interchanged coordinates are.

    Args:
        steps: Steps of one deployment, in the order in which they were executed.
    """
    states = steps.state[:COMPARED_STEPS]
    if not len(states):
        return
    when = f"In the first {len(states)} steps" if len(states) > 1 else "In the first step"
    for quantity, values in zip(steps.space.state, states.T, strict=True):
        beyond = np.maximum(quantity.lower - values, values - quantity.upper) / (quantity.upper - quantity.lower)
        if np.median(beyond) > FAR_RANGES:
            middle = values[np.argsort(beyond)[len(values) // 2]]
            yield (
                f"{when} of deployment {steps.iterations[0]}, {quantity.name} was about {middle:.4g}, but its range of "
                f"use is {quantity.lower:g} to {quantity.upper:g} {quantity.unit or '(no unit)'}: check the unit in "
                "which the plant gives it, and the range."
            )
