"""The normal distribution: 95 % intervals of values and of standard deviations, and its log density."""

import math
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import chdtri

INTERVAL_95: Final = 1.96
"""Standard deviations on either side of the mean that hold 95 % of a normal distribution."""


def std_interval_95(std: ArrayLike, freedom: ArrayLike) -> NDArray[np.float64]:
    """95 % confidence interval of a standard deviation: σ² is freedom · std² / χ², with `freedom` degrees of freedom.

    Args:
        std: Estimates, which broadcast with `freedom`; shape (…).
        freedom: Degrees of freedom of the estimates, which need not be integers; NaN where they are not known.

    Returns:
        Lower and upper ends, NaN where a number is not known; shape (2, …).
    """
    std, freedom = np.broadcast_arrays(np.asarray(std, float), np.asarray(freedom, float))
    return std * np.sqrt(np.stack([freedom / chdtri(freedom, 0.025), freedom / chdtri(freedom, 0.975)]))


def log_density(error: NDArray[np.float64], std: NDArray[np.float64]) -> NDArray[np.float64]:
    """Logarithm of the density of errors of mean zero with standard deviations `std`; same shape [nats]."""
    return -0.5 * (error / std) ** 2 - np.log(std) - 0.5 * math.log(2 * math.pi)
