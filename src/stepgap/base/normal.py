"""The normal distribution: its 95 % interval and its log density."""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

INTERVAL_95: Final = 1.96
"""Standard deviations on either side of the mean that hold 95 % of a normal distribution."""


def log_density(error: NDArray[np.float64], std: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithm of the density of errors of mean zero with standard deviations `std`; same shape [nats]."""
    return -0.5 * (error / std) ** 2 - np.log(std) - 0.5 * math.log(2 * math.pi)
