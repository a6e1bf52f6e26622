"""95 % confidence intervals of the numbers in a report, as values and as text."""

from typing import Final

import numpy as np

from stepgap.base.normal import std_interval_95
from stepgap.learning.steps import Steps
from stepgap.report.decimals import decimal
from stepgap.step import Array

FEWEST_TRACKED: Final = 20
"""Smallest number of steps from which an interval is computed."""


def rmse_interval(steps: Steps) -> Array:
    """95 % confidence interval of the tracking RMSE of a deployment, with the reference as it was.

    Errors of neighbouring steps are correlated, so the variance of the mean square follows from the means of all
    blocks of N^(1/3) consecutive steps, as in the circular block bootstrap (Politis and Romano, Exploring the Limits of
    Bootstrap, 1992). The mean square is then taken as that of independent normal errors with the same relative
    variance, 2 / (degrees of freedom). In simulations with 227 steps, intervals so computed contained the true RMSE in
    94 % of cases for independent errors, and in 91 % for errors with a correlation of 0.5 from step to step.

    Args:
        steps: Steps of one deployment.

    Returns:
        Lower and upper ends [units of the state], NaN for fewer than `FEWEST_TRACKED` steps; shape (2, n).
    """
    squares = steps.tracking_errors() ** 2
    count, size = squares.shape
    if count < FEWEST_TRACKED:
        return np.full((2, size), np.nan)
    length = round(count ** (1 / 3))
    sums = np.cumsum(np.vstack([np.zeros((1, size)), squares, squares[: length - 1]]), axis=0)
    blocks = (sums[length:] - sums[:-length]) / length  # mean of the block that starts at each step
    mean = squares.mean(axis=0)
    variance = np.mean((blocks - mean) ** 2, axis=0) * length / (count - length)
    degrees_of_freedom = np.divide(2 * mean**2, variance, out=np.full(size, np.nan), where=variance > 0)
    return std_interval_95(np.sqrt(mean), degrees_of_freedom)


def between(ends: Array, unit: str = "", digits: int = 3) -> str:
    """Text of a 95 % interval after the value it belongs to; empty where it is not known."""
    if not np.isfinite(ends).all():
        return ""
    return f" (95 % interval {decimal(ends[0], digits)} to {decimal(ends[1], digits)}{unit})"
