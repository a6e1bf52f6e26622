"""Measured states that are far from what was expected: outside their ranges of use, or on one side of all targets."""

from collections.abc import Iterable

import numpy as np

from stepgap.learning.steps import Steps
from stepgap.records.text import decimal, unit_suffix

COMPARED_STEPS = 5
"""Number of steps of a deployment, at most, whose states are compared with the ranges of use."""

FAR_RANGES = 3.0
"""A state is far outside its range of use if it is more than this number of widths of the range away from it."""

FEWEST_OFFSET = 5
"""Smallest number of steps that show that a coordinate stays away from its targets."""

FAR_OFFSET = 2.0
"""Smallest ratio of a mean error to its scatter that is called an offset."""


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


def offset_sentences(deployment: Steps) -> list[str]:
    """Sentences on coordinates that ended on the same side of all their targets, far away, in a deployment.

    Before anything was learned, that is an error of the nominal map unless it is larger than half the range of use.
    """
    steps = deployment.tracking().completed()
    if len(steps) < FEWEST_OFFSET:
        return []
    sentences = []
    for row, quantity in enumerate(steps.space.state):
        error, ends, unit = steps.tracking_errors()[:, row], steps.next_state[:, row], unit_suffix(quantity)
        low, high = error.min(), error.max()
        apart = ends.max() < steps.target[:, row].min() or ends.min() > steps.target[:, row].max()
        if low * high <= 0 or not apart or abs(error.mean()) < FAR_OFFSET * error.std():
            continue
        if not steps.std.any() and abs(error.mean()) < steps.space.state_scale[row]:
            continue
        side, least, most = ("above", low, high) if low > 0 else ("below", -high, -low)
        sentences.append(
            f"In all {len(steps)} steps of deployment {steps.iterations[0]}, {quantity.name} ended {side} all targets, "
            f"{decimal(least)} to {decimal(most)}{unit} from its own."
        )
    return sentences
