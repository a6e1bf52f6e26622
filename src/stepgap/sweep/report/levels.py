"""Statistics of the cases at each level of an axis, with 95 % intervals that treat the cases as independent."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from stepgap.base.normal import INTERVAL_95
from stepgap.step import Array
from stepgap.sweep.report.cases import LevelCodes, SweepAxis, SweepCases


class Estimates(NamedTuple):
    """Estimates for L levels, NaN where there is no case, with the ends of their 95 % intervals.

    Attributes:
        counts: Number of cases, or of pairs of cases; shape (L,).
        values: Estimates; shape (L,).
        lower: Lower ends; shape (L,). NaN where the interval is not known.
        upper: Upper ends; shape (L,).
    """

    counts: LevelCodes
    values: Array
    lower: Array
    upper: Array


def geometric_means(errors: Array, codes: LevelCodes, levels: int) -> Estimates:
    """Geometric mean of the known errors at each level; the interval is Student's, of the mean logarithm.

    Args:
        errors: Positive errors, NaN where unknown; shape (N,).
        codes: Level of each case; shape (N,).
        levels: Number of levels.
    """
    known = np.isfinite(errors)
    logs, codes = np.log(errors[known]), codes[known]
    counts = np.bincount(codes, minlength=levels)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.bincount(codes, logs, levels) / counts
        squares = np.bincount(codes, (logs - means[codes]) ** 2, levels)
        half = stdtrit(counts - 1, 0.975) * np.sqrt(squares / (counts - 1) / counts)
    return Estimates(counts, np.exp(means), np.exp(means - half), np.exp(means + half))


def level_means(axis: SweepAxis, errors: Array) -> Estimates:
    """Geometric mean of the known errors at each level of an axis; if the levels are ranges, that of the points' means.

    Args:
        axis: Levels of the N cases.
        errors: Positive errors, NaN where unknown; shape (N,).
    """
    if axis.points is None:
        return geometric_means(errors, axis.codes, len(axis.levels))
    known = np.isfinite(errors)
    _, first, of_case, counts = np.unique(
        axis.points[known], return_index=True, return_inverse=True, return_counts=True
    )
    means = np.exp(np.bincount(of_case, np.log(errors[known]), len(counts)) / counts)
    return geometric_means(means, axis.codes[known][first], len(axis.levels))


def overall_mean(errors: Array) -> float:
    """Geometric mean of the known errors; NaN if there is none."""
    return float(geometric_means(errors, np.zeros(len(errors), np.int64), 1).values[0])


def shares(chosen: NDArray[np.bool_], codes: LevelCodes, levels: int) -> Estimates:
    """Share of the chosen cases at each level, with Wilson's score interval (J. Am. Stat. Assoc. 22, 1927).

    Args:
        chosen: Whether a case counts; shape (N,).
        codes: Level of each case; shape (N,).
        levels: Number of levels.
    """
    counts = np.bincount(codes, minlength=levels)
    with np.errstate(invalid="ignore", divide="ignore"):
        share = np.bincount(codes[chosen], minlength=levels) / counts
        scale = 1 / (1 + INTERVAL_95**2 / counts)
        centre = scale * (share + INTERVAL_95**2 / (2 * counts))
        half = scale * INTERVAL_95 * np.sqrt(share * (1 - share) / counts + (INTERVAL_95 / (2 * counts)) ** 2)
    lower, upper = np.maximum(centre - half, 0), np.minimum(centre + half, 1)
    return Estimates(counts, share, lower, upper)


def quartiles(values: Array, codes: LevelCodes, levels: int) -> Array:
    """Quartiles of values, which may be infinite, at each level: the smallest that 25, 50, 75 % do not exceed.

    Args:
        values: Values without NaN; shape (N,).
        codes: Level of each case; shape (N,).
        levels: Number of levels.

    Returns:
        Array of shape (3, L), NaN at levels without a case.
    """
    ordered = np.append(values[np.lexsort((values, codes))], np.nan)
    counts = np.bincount(codes, minlength=levels)
    begins = np.cumsum(counts) - counts
    ranks = np.ceil(np.array([[0.25], [0.5], [0.75]]) * counts).astype(int) - 1
    return ordered[np.where(counts > 0, begins + ranks, len(values))]


def matched_groups(cases: SweepCases, axis: SweepAxis) -> LevelCodes:
    """Index of the group of each case: in a group all settings except that of the axis are equal, the seed, too."""
    groups = np.zeros(len(cases), np.int64)
    for name, setting in cases.settings.items():
        if name != axis.name:
            _, groups = np.unique(groups * len(setting.texts) + setting.codes, return_inverse=True)
    return groups


def paired_ratios(groups: LevelCodes, axis: SweepAxis, errors: Array) -> Estimates:
    """Ratio of the errors at each level to those at the first level, from the pairs of cases in the same group.

    The ratio is the geometric mean over the pairs; its interval is Student's, of the mean difference of logarithms.

    Args:
        groups: Group of each case; shape (N,).
        axis: Levels of the cases.
        errors: Positive errors, NaN where unknown; shape (N,).
    """
    known = np.isfinite(errors)
    order = np.flatnonzero(known)[np.lexsort((axis.codes[known], groups[known]))]
    groups, codes, logs = groups[order], axis.codes[order], np.log(errors[order])
    once = np.flatnonzero((np.diff(groups, prepend=-1) != 0) | (np.diff(codes, prepend=-1) != 0))
    groups, codes, logs = groups[once], codes[once], logs[once]
    first = np.full(int(groups.max(initial=0)) + 1, np.nan)
    first[groups[codes == 0]] = logs[codes == 0]
    return geometric_means(np.exp(logs - first[groups]), codes, len(axis.levels))
