"""References of a hopper that tracks footholds: targets of the height and of the stride from foothold to foothold."""

import numpy as np

from stepgap.control.reference import Reference
from stepgap.step import Array

_NAMES = ("height", "stride")

STRIDES_GIVEN = 227  # Number of targets, as many as the paper's reference has
STRIDES = (0.05, 0.42)  # Shortest and longest random stride [m]
HEIGHTS = (0.55, 0.61)  # Lowest and highest random height above the ground [m]
OVER_STONES = 0.58  # Height above the stones [m]


def random_strides() -> Reference:
    """Random strides and heights, always the same, from which a map of footholds is learned."""
    low, high = np.transpose([HEIGHTS, STRIDES])
    return Reference(_NAMES, np.random.default_rng(0).uniform(low, high, (STRIDES_GIVEN, 2)))


def stones_reference(stones: Array, length: float) -> Reference:
    """Strides from stone to stone, again and again around a ground.

    Args:
        stones: Places of their middles, ascending from 0 [m]; shape (k,).
        length: Length of the ground [m].
    """
    strides = np.resize(np.diff(np.append(stones, length)), STRIDES_GIVEN)
    return Reference(_NAMES, np.column_stack([np.full(STRIDES_GIVEN, OVER_STONES), strides]))
