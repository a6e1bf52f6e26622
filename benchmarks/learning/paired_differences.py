"""Paired differences between two methods over twins and seeds, and their significance.

The difference on one twin and seed is d = log(error / error of the other method). Seeds of one twin are not
independent, because it has the same gap and the same floor in all of them. So the seeds' mean is one number for each
twin, and Student's t distribution over the twins gives the 95 % interval of the mean of d and the p-value of d = 0.
Both are exact if the twins' means are normally distributed, and good for some ten twins if they are not.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from scipy.special import stdtr, stdtrit

from stepgap.step import Array

LARGEST_RATIO = 30.0
"""A ratio of errors that is larger, or smaller than its inverse, counts as this; a failed step is an infinite error."""

CONFIDENCE = 0.95
"""Probability of the intervals; a difference is significant if its adjusted p-value is below 1 − this."""

Errors = Mapping[tuple[int, int], float]
"""Error by twin and seed; infinite if a step failed."""


@final
@dataclass(frozen=True)
class PairedDifference:
    """How much larger the errors of one method are than those of another one.

    Attributes:
        ratio: Geometric mean of the ratio over the twins.
        low: Lower end of its 95 % interval; NaN for a single twin.
        high: Upper end.
        p_value: Probability of a mean of d at least as far from zero if there is no difference; NaN for a single twin.
    """

    ratio: float
    low: float
    high: float
    p_value: float


def paired_difference(errors: Errors, others: Errors) -> PairedDifference:
    """Compares errors with those of another method on the same twins and seeds."""
    means = twin_means(errors, others)
    count, mean = len(means), float(means.mean())
    if count < 2:
        return PairedDifference(float(np.exp(mean)), np.nan, np.nan, np.nan)
    standard_error = float(means.std(ddof=1)) / np.sqrt(count)
    half_width = standard_error * stdtrit(count - 1, 0.5 + CONFIDENCE / 2)
    far = abs(mean) / standard_error if standard_error > 0 else np.inf if mean else 0.0
    low, ratio, high = np.exp([mean - half_width, mean, mean + half_width]).tolist()
    return PairedDifference(ratio, low, high, float(2 * stdtr(count - 1, -far)))


def log_ratio(error: float, other: float) -> float:
    """Difference d on one twin and seed, within ±log `LARGEST_RATIO`; zero if both deployments were aborted."""
    if error == other:
        return 0.0
    with np.errstate(divide="ignore"):
        return float(np.clip(np.log(np.divide(error, other)), -np.log(LARGEST_RATIO), np.log(LARGEST_RATIO)))


def twin_means(errors: Errors, others: Errors) -> Array:
    """Mean of d over the seeds of each twin; shape (twins,)."""
    by_twin: dict[int, list[float]] = {}
    for (twin, seed), error in errors.items():
        by_twin.setdefault(twin, []).append(log_ratio(error, others[twin, seed]))
    return np.array([float(np.mean(ratios)) for ratios in by_twin.values()])


def holm(p_values: Sequence[float]) -> list[float]:
    """P-values adjusted for the number of comparisons (Holm 1979): all that are below 0.05 are significant together.

    A p-value that is NaN stays NaN and does not count as a comparison.
    """
    adjusted, known = np.array(p_values, float), np.flatnonzero(np.isfinite(p_values))
    order = known[np.argsort(adjusted[known])]
    steps = adjusted[order] * np.arange(len(order), 0, -1)
    adjusted[order] = np.minimum(np.maximum.accumulate(steps), 1.0)
    return adjusted.tolist()
