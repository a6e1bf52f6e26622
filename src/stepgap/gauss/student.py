"""Student's t distribution, which is that of a value whose noise has a variance that is known from few values only."""

from math import lgamma, log, pi

import numpy as np

from stepgap.step import Array


def log_student(error: Array, variance: Array, freedom: float) -> float:
    """Logarithm of the density of errors (n,) that share their degrees of freedom.

    Args:
        error: Differences from the mean.
        variance: Squared scales of the uncorrelated coordinates; shape (n,).
        freedom: Degrees of freedom.
    """
    n = len(error)
    half = (freedom + len(error)) / 2
    constant = lgamma(half) - lgamma(freedom / 2) - n / 2 * log(freedom * pi)
    return constant - float(np.sum(np.log(variance))) / 2 - half * log(1 + float(np.sum(error**2 / variance)) / freedom)
