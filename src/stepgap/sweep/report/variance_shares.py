"""Sensitivity: shares of the variance of the logarithm of the last error that axes and pairs of axes explain.

The logarithm is described by an additive model, with one effect per level of each axis. The share of an axis is
ε² = (SS − ν·MSE)/SS_total: SS is the sum of squares of its effects, ν their degrees of freedom, and MSE the mean square
of the remainder; ν·MSE is what SS would be by chance (Kelley, "An unbiased correlation ratio measure", PNAS 21, 1935;
Okada, "Is omega squared less biased?", Behaviormetrika 40, 2013). A share may therefore be slightly negative. The share
of a pair of axes is that of its interaction: SS is what the means of the cells of both explain of the remainder beyond
two additive effects, and MSE the mean square within the cells.

The levels of a setting with many values are ranges. What such levels do not explain is the same in all cases with the
same point, the combination of all these values. So for their shares the points are the units, not the cases, as in the
analysis of split plots. The points of a Sobol' sequence are more even than random ones: of them, chance explains a
little less than ν·MSE, so that these shares are slightly too small (up to 0.015 with 256 points in simulations). What
varies within the ranges is missing in a share, too, which matters if few points leave only two or three ranges.

Intervals are basic bootstrap intervals with inflated residuals (Davison & Hinkley, "Bootstrap Methods and Their
Application", 1997, sections 2.6, 3.8 and 5.2.1): units are drawn again, in at most 200 random groups. The errors of ε²
in these draws are relative to the share of variance in the data from which they are drawn, which needs no correction.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Final, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from stepgap.records.missing import Missing
from stepgap.step import Array
from stepgap.sweep.report.additive_model import (
    AdditiveModel,
    additive_model,
    explained_by_levels,
    explained_by_two,
    sums_by_level,
)
from stepgap.sweep.report.cases import LevelCodes, SweepAxis, SweepCases

LEAST_UNITS: Final = 16
"""Smallest number of units, cases or points, for which a share is computed."""

UNITS_PER_CELL: Final = 2
"""Smallest mean number of units at a level, or at a combination of two levels."""

MOST_CELLS: Final = 10_000
"""Largest number of levels of an axis, and of combinations of the levels of two axes."""

MOST_AXES: Final = 12
"""Number of axes with the largest shares of which pairs are examined, and figures are drawn."""

DRAWS: Final = 500
"""Number of bootstrap draws."""

GROUPS: Final = 200
"""Largest number of groups of units that are drawn."""

_NUMBERS_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class VarianceShare:
    """Share of the variance of the logarithm of the last error, by state coordinate.

    Attributes:
        names: One axis, whose effect it is, or two, whose interaction it is.
        values: Shares; shape (n,).
        lower: Lower ends of the 95 % intervals; shape (n,).
        upper: Upper ends; shape (n,).
    """

    names: tuple[str, ...]
    values: Array
    lower: Array
    upper: Array


@dataclass(frozen=True, eq=False)
class VarianceShares:
    """Shares of all axes and pairs of axes for which there are enough cases, the largest first.

    Attributes:
        cases: Number of cases that were used.
        axes: Shares of single axes.
        pairs: Shares of the interactions of two axes.
        left_out: Axes, and pairs of axes, with too few cases or points per level or combination.
    """

    cases: int
    axes: tuple[VarianceShare, ...]
    pairs: tuple[VarianceShare, ...]
    left_out: tuple[tuple[str, ...], ...]

    @property
    def remainder(self) -> Array:
        """Share that neither single axes nor pairs explain; shape (n,)."""
        return 1 - sum((share.values for share in (*self.axes, *self.pairs)), np.zeros(1))


def variance_shares(cases: SweepCases, rng: np.random.Generator) -> VarianceShares | Missing:
    """Computes the shares from the cases whose last errors are known and whose last deployment was not aborted.

    Args:
        cases: The cases.
        rng: Draws the bootstrap samples.

    Returns:
        The shares, or the reason why there are none.
    """
    used = cases.comparable
    logs = np.log(cases.last_errors[used]).T
    count = logs.shape[1]
    if count < LEAST_UNITS:
        return Missing(f"cases with comparable errors are fewer than {LEAST_UNITS}")
    logs = logs - logs.mean(axis=1, keepdims=True)
    if (np.ptp(logs, axis=1) < 1e-9).any():
        return Missing("an error is the same in all cases")
    axes = [axis.select(used) for axis in cases.axes]
    enough = [axis for axis in axes if _fits(len(_Units.of([axis]).counts), len(axis.levels))]
    model = additive_model(logs, enough)
    singles = {(axis.name,): _axis_share(model, logs, row, rng) for row, axis in enumerate(enough)}
    shown = _sorted(singles.values())[:MOST_AXES]
    kept = [axis for axis in enough if any((axis.name,) == share.names for share in shown)]
    pairs = {
        (one.name, other.name): _pair_share(model, logs, (one, other), rng) for one, other in combinations(kept, 2)
    }
    if not shown:
        return Missing(f"{count} cases are too few for these axes")
    left_out = [(axis.name,) for axis in axes if singles.get((axis.name,)) is None]
    left_out += [names for names, share in pairs.items() if share is None]
    return VarianceShares(count, _sorted(singles.values()), _sorted(pairs.values()), tuple(left_out))


class _Units(NamedTuple):
    """Independent units: single cases, or groups of cases.

    Attributes:
        of_case: Unit of each case; shape (N,).
        first: A case of each unit; shape (U,).
        counts: Number of cases of each unit; shape (U,).
    """

    of_case: LevelCodes
    first: LevelCodes
    counts: LevelCodes

    @classmethod
    def of(cls, axes: Sequence[SweepAxis]) -> Self:
        """Units for an effect of these axes: the cases or, if an axis has ranges, the points and other levels."""
        points = next((axis.points for axis in axes if axis.points is not None), None)
        if points is None:
            every = np.arange(len(axes[0].codes))
            return cls(every, every, np.ones_like(every))
        for axis in axes:
            if axis.points is None:
                points = points * len(axis.levels) + axis.codes
        _, first, of_case, counts = np.unique(points, return_index=True, return_inverse=True, return_counts=True)
        return cls(of_case, first, counts)

    def means(self, values: Array) -> Array:
        """Means of values of the cases; (n, N) to (n, U)."""
        return sums_by_level(values, self.of_case, len(self.counts)) / self.counts


class _Draws:
    """Bootstrap draws of units; the first of the 1 + DRAWS draws is the data from which the others are drawn.

    Args:
        units: The units.
        values: Values of the cases in these data, for the total sums of squares; shape (n, N).
        rng: Draws.
    """

    def __init__(self, units: _Units, values: Array, rng: np.random.Generator):
        number = min(len(units.counts), GROUPS)
        self._units, self._groups = units, rng.permutation(len(units.counts)) % number
        drawn = rng.multinomial(number, np.full(number, 1 / number), size=DRAWS)
        self._weights = np.vstack([np.ones((1, number)), drawn])
        self._sizes = np.bincount(self._groups, minlength=number) @ self._weights.T
        groups, ones = self._groups[units.of_case], np.ones((1, values.shape[1]))
        counts, sums, squares = (
            sums_by_level(each, groups, number) @ self._weights.T for each in (ones, values, values**2)
        )
        self.totals = squares - sums**2 / counts

    def sums(self, values: Array, codes: LevelCodes, levels: int, draws: slice = slice(None)) -> "_Sums":
        """Sums over the cases in each of D draws.

        Args:
            values: Values of the units; shape (n, U).
            codes: Level of each unit; shape (U,).
            levels: Number of levels.
            draws: The draws.
        """
        weights, weighted = self._weights[draws], values * self._units.counts
        number, cells = weights.shape[1], self._groups * levels + codes
        counts = np.bincount(cells, self._units.counts, number * levels).reshape(number, levels)
        sums = sums_by_level(weighted, cells, number * levels).reshape(-1, number, levels)
        squares = sums_by_level(weighted * values, self._groups, number)
        return _Sums(weights @ counts, weights @ sums, squares @ weights.T, self._sizes[draws])


class _Sums(NamedTuple):
    """Sums over the cases in each of D draws.

    Attributes:
        counts: Numbers of cases by level; shape (D, L).
        values: Values by level; shape (n, D, L).
        squares: Squares of the values; shape (n, D).
        units: Numbers of units; shape (D,).
    """

    counts: NDArray[Any]
    values: Array
    squares: NDArray[Any]
    units: NDArray[Any]


def _fits(units: int, cells: int) -> bool:
    return units >= LEAST_UNITS and UNITS_PER_CELL * cells <= units and cells <= MOST_CELLS


def _axis_share(model: AdditiveModel, logs: Array, row: int, rng: np.random.Generator) -> VarianceShare | None:
    """Share of the effects of one axis; in the bootstrap, those of the other axes stay as they are."""
    axis, effect = model.axes[row], model.effects[row]
    units, levels = _Units.of([axis]), len(axis.levels)
    number, codes = len(units.counts), axis.codes[units.first]
    varied = [other for other in model.axes if axis.points is None or other.points is not None]
    degrees_of_freedom = number - 1 - sum(len(other.levels) - 1 for other in varied)
    if degrees_of_freedom < number // 4:
        return None
    rest = units.means(model.remainder)
    error = (rest**2 @ units.counts) / degrees_of_freedom
    explained = (np.bincount(axis.codes, minlength=levels) * effect**2).sum(axis=1)
    values = (explained - (levels - 1) * error) / (logs**2).sum(axis=1)
    inflated = rest * np.sqrt(number / degrees_of_freedom)
    draws = _Draws(units, logs + (inflated - rest)[:, units.of_case], rng)
    sums = draws.sums(effect[:, codes] + inflated, codes, levels)
    between, filled = explained_by_levels(sums.counts, sums.values), np.count_nonzero(sums.counts, axis=1)
    error = (sums.squares - between) / np.maximum(sums.units - filled, 1)
    between -= sums.values.sum(axis=2) ** 2 / sums.counts.sum(axis=1)
    return _with_interval((axis.name,), values, between, between - (filled - 1) * error, draws.totals)


def _pair_share(
    model: AdditiveModel, logs: Array, axes: tuple[SweepAxis, SweepAxis], rng: np.random.Generator
) -> VarianceShare | None:
    """Share of the interaction of two axes; None if there are too few units."""
    units = _Units.of(axes)
    number = len(units.counts)
    shape, codes = _cells(axes, units)
    levels, cells = shape[0] * shape[1], len(np.unique(codes))
    if levels > MOST_CELLS or not _fits(number, cells):
        return None
    rest = units.means(model.remainder)
    counts = np.maximum(np.bincount(codes, units.counts, levels), 1)
    means = (sums_by_level(rest * units.counts, codes, levels) / counts)[:, codes]
    inflated = means + (rest - means) * np.sqrt(number / (number - cells))
    draws = _Draws(units, logs + (inflated - rest)[:, units.of_case], rng)
    own = _interaction(draws.sums(rest, codes, levels, slice(1)), shape)
    if not own.degrees_of_freedom[0]:
        return None
    step = max(1, _NUMBERS_AT_ONCE // levels)
    parts = [
        _interaction(draws.sums(inflated, codes, levels, slice(at, at + step)), shape)
        for at in range(0, DRAWS + 1, step)
    ]
    explained, corrected = (np.hstack([getattr(part, name) for part in parts]) for name in ("explained", "corrected"))
    values = own.corrected[:, 0] / (logs**2).sum(axis=1)
    return _with_interval((axes[0].name, axes[1].name), values, explained, corrected, draws.totals)


def _cells(axes: tuple[SweepAxis, SweepAxis], units: _Units) -> tuple[tuple[int, int], LevelCodes]:
    """Numbers of levels of two axes, and the combination of each unit; ranges are joined if there are few units."""
    found = []
    for axis, across in (axes, axes[::-1]):
        others, enough = len(across.levels), len(units.counts) / (2 * UNITS_PER_CELL)
        most = int(max(enough / others, np.sqrt(enough) if across.points is not None else 0, 2))
        levels = len(axis.levels) if axis.points is None else min(len(axis.levels), most)
        found.append((levels, axis.codes[units.first] * levels // len(axis.levels)))
    (rows, first), (columns, second) = found
    return (rows, columns), first * columns + second


class _Interaction(NamedTuple):
    """An interaction in D draws.

    Attributes:
        explained: Sum of squares; shape (n, D).
        corrected: Sum of squares without what is explained by chance; shape (n, D).
        degrees_of_freedom: Degrees of freedom; shape (D,).
    """

    explained: Array
    corrected: Array
    degrees_of_freedom: Array


def _interaction(sums: _Sums, shape: tuple[int, int]) -> _Interaction:
    between, cells = explained_by_levels(sums.counts, sums.values), np.count_nonzero(sums.counts, axis=1)
    values = sums.values.reshape(len(sums.values), -1, *shape)
    additive, effects = explained_by_two(sums.counts.reshape(-1, *shape), values)
    error = (sums.squares - between) / np.maximum(sums.units - cells, 1)
    explained, degrees_of_freedom = between - additive, cells - effects
    return _Interaction(explained, explained - degrees_of_freedom * error, degrees_of_freedom)


def _with_interval(
    names: tuple[str, ...], values: Array, explained: Array, corrected: Array, totals: Array
) -> VarianceShare:
    """A share with its basic bootstrap interval.

    Args:
        names: Its axes.
        values: The shares; shape (n,).
        explained: Sums of squares in the draws, the first of which is the data; shape (n, 1 + DRAWS).
        corrected: The same without what is explained by chance; shape (n, 1 + DRAWS).
        totals: Total sums of squares; shape (n, 1 + DRAWS).
    """
    errors = corrected[:, 1:] / totals[:, 1:] - explained[:, :1] / totals[:, :1]
    above, below = np.quantile(errors, [0.975, 0.025], axis=1)
    return VarianceShare(names, values, values - above, values - below)


def _sorted(shares: Iterable[VarianceShare | None]) -> tuple[VarianceShare, ...]:
    return tuple(sorted(filter(None, shares), key=lambda share: -float(share.values.max())))
