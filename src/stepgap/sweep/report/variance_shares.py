"""Sensitivity: the share of the variance of the logarithm of the last error that the effects of each axis explain.

The logarithm is described by one effect per level of each axis, by least squares. The share of an axis is
ε² = (SS − ν·MSE)/SS_total: SS is the sum of squares that its effects explain beyond those of the other axes, ν their
degrees of freedom, and MSE the mean square of the remainder; ν·MSE is what SS would be by chance (Kelley, "An unbiased
correlation ratio measure", PNAS 21, 1935).
A share may therefore be slightly negative. Its probability by chance is that of the F test. If the levels of an axis
are ranges, cases with the same point are alike in all that the levels do not explain, so for this axis the units whose
remainders are counted are points, not cases.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.linalg import lsqr
from scipy.special import fdtrc

from stepgap.records.missing import Missing
from stepgap.step import Array
from stepgap.sweep.report.cases import LevelCodes, SweepAxis, SweepCases

LEAST_CASES: Final = 16
"""Smallest number of cases for which shares are computed."""

LEAST_POINTS: Final = 32
"""Smallest number of points; of 16 points of a Sobol' sequence, the ranges of several settings are often correlated."""

UNITS_PER_LEVEL: Final = 2
"""Smallest mean number of units, cases or points, at a level."""


@dataclass(frozen=True, eq=False)
class VarianceShare:
    """Share of the variance of the logarithm of the last error that one axis explains, by state coordinate.

    Attributes:
        name: The axis.
        values: Shares; shape (n,).
        chance: Probability that an axis without effect has such a share or a larger one; shape (n,).
    """

    name: str
    values: Array
    chance: Array


@dataclass(frozen=True, eq=False)
class VarianceShares:
    """Shares of all axes for which there are enough cases, the largest first.

    Attributes:
        cases: Number of cases that were used.
        axes: Shares of the axes.
        left_out: Axes with too few cases or points per level.
    """

    cases: int
    axes: tuple[VarianceShare, ...]
    left_out: tuple[str, ...]

    @property
    def remainder(self) -> Array:
        """Share that no single axis explains; shape (n,)."""
        return 1 - np.sum([share.values for share in self.axes], axis=0)


def variance_shares(cases: SweepCases) -> VarianceShares | Missing:
    """Computes the shares from the cases whose last errors are known and whose last deployment was not aborted.

    Returns:
        The shares, or the reason why there are none.
    """
    used = cases.comparable
    logs = np.log(cases.last_errors[used]).T
    count = logs.shape[1]
    if count < LEAST_CASES:
        return Missing(f"cases with comparable errors are fewer than {LEAST_CASES}")
    if (np.ptp(logs, axis=1) < 1e-9).any():
        return Missing("an error is the same in all cases")
    logs = logs - logs.mean(axis=1, keepdims=True)
    axes = [axis.select(used) for axis in cases.axes]
    enough = [axis for axis in axes if _has_enough(axis)]
    shares = sorted(_shares(logs, enough), key=lambda share: -float(share.values.max()))
    if not shares:
        return Missing(f"{count} cases are too few for these axes")
    known = {share.name for share in shares}
    return VarianceShares(count, tuple(shares), tuple(axis.name for axis in axes if axis.name not in known))


def _units(axis: SweepAxis) -> LevelCodes:
    """Unit of each case: the point if the levels are ranges, else the case."""
    return np.arange(len(axis.codes)) if axis.points is None else axis.points


def _has_enough(axis: SweepAxis) -> bool:
    least = LEAST_CASES if axis.points is None else LEAST_POINTS
    return len(np.unique(_units(axis))) >= max(least, UNITS_PER_LEVEL * len(axis.levels))


def _shares(logs: Array, axes: Sequence[SweepAxis]) -> list[VarianceShare]:
    """Shares of axes in logarithms with mean zero, shape (n, N); without those for which too few units remain."""
    remainder, found = _remainder(logs, axes), []
    for axis in axes:
        _, units, counts = np.unique(_units(axis), return_inverse=True, return_counts=True)
        varied = [other for other in axes if axis.points is None or other.points is not None]
        own, left = len(axis.levels) - 1, len(counts) - 1 - sum(len(other.levels) - 1 for other in varied)
        if left < len(counts) // 4:
            continue
        without = _remainder(logs, [other for other in axes if other is not axis])
        total, explained = (logs**2).sum(axis=1), (without**2 - remainder**2).sum(axis=1)
        rest = np.array([np.sum(np.bincount(units, row) ** 2 / counts) for row in remainder])
        error = np.maximum(rest, 1e-12 * total) / left
        chance = fdtrc(own, left, np.maximum(explained / own / error, 0))
        found.append(VarianceShare(axis.name, (explained - own * error) / total, chance))
    return found


def _remainder(logs: Array, axes: Sequence[SweepAxis]) -> Array:
    """What the effects of these axes do not explain, by least squares; shapes (n, N)."""
    if not axes:
        return logs
    ends = np.cumsum([len(axis.levels) for axis in axes])
    columns = np.stack([axis.codes + end - len(axis.levels) for axis, end in zip(axes, ends, strict=True)], axis=1)
    rows = np.arange(0, columns.size + 1, len(axes))
    indicators = csr_array((np.ones(columns.size), columns.ravel(), rows), shape=(len(columns), int(ends[-1])))
    return np.array([row - indicators @ lsqr(indicators, row, atol=1e-10, btol=1e-10)[0] for row in logs])
