"""Means and ratios with their 95 % intervals by Student's t."""

from collections.abc import Sequence

import numpy as np
from scipy.stats import t as student

from stepgap.step import Array


def half_width(samples: Array) -> Array:
    """Half the width of the 95 % interval of the mean of samples along the first axis."""
    count = len(samples)
    return np.asarray(student.ppf(0.975, count - 1) * np.std(samples, axis=0, ddof=1) / np.sqrt(count), float)


def ratio(logs: Sequence[float] | Array) -> str:
    """Geometric mean of ratios, of which the logarithms are given, with its interval if there are several."""
    mean = float(np.mean(logs))
    if len(logs) < 2:
        return f"{np.exp(mean):.2f}"
    half = float(half_width(np.asarray(logs)))
    return f"{np.exp(mean):.2f} ({np.exp(mean - half):.2f} to {np.exp(mean + half):.2f})"
