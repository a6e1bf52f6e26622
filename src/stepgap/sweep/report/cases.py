"""The cases of a sweep, with one entry each, and the levels of the settings on its axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, as_numbers

LevelCodes = NDArray[np.int64]
"""Indices of levels."""

MOST_LEVELS: Final = 16
"""Number of different numbers up to which each is a level; more of them are divided into ranges."""

RANGES: Final = (2, 10)
"""Smallest and largest number of ranges into which a numeric setting is divided."""

POINTS_PER_RANGE: Final = 3
"""Number of points per range and divided setting, if there are few points."""

NOMINAL: Final = ("twin",)
"""Settings whose numbers are names, because they have no order."""

_LARGEST_CASE: Final = 10**8


class SettingTexts(NamedTuple):
    """A setting in N cases.

    Attributes:
        texts: The different values, as texts; shape (K,).
        codes: Index of the text of each case; shape (N,).
    """

    texts: NDArray[Any]
    codes: LevelCodes

    def of_case(self, row: int) -> str:
        """Text of the setting in the case of a row."""
        return str(self.texts[self.codes[row]])


@dataclass(frozen=True, eq=False)
class SweepAxis:
    """A setting with at least two different values in N cases.

    Attributes:
        name: Name of the setting.
        levels: Texts of its L levels: in ascending order, or for names in the order of the cases.
        codes: Level of each case; shape (N,).
        values: Value of each case; shape (N,). None for names.
        points: If the levels are ranges of values: the point of each case, which is the combination of the values of
            all settings that are divided into ranges; shape (N,). None if each value is a level.
    """

    name: str
    levels: tuple[str, ...]
    codes: LevelCodes
    values: Array | None = None
    points: LevelCodes | None = None

    def select(self, chosen: NDArray[np.bool_]) -> "SweepAxis":
        """The axis in the chosen cases, with the same levels."""
        values = None if self.values is None else self.values[chosen]
        points = None if self.points is None else self.points[chosen]
        return SweepAxis(self.name, self.levels, self.codes[chosen], values, points)


@dataclass(frozen=True, eq=False)
class FailedCase:
    """A case without a result.

    Attributes:
        number: Number of the case.
        settings: Texts of the settings on the axes.
        reason: Reason why it failed.
    """

    number: int
    settings: tuple[str, ...]
    reason: str


@dataclass(frozen=True, eq=False)
class SweepCases:
    """The N cases of a sweep that have a result, in ascending order, and those that failed.

    An error is NaN where it cannot be compared, because a step of the deployment failed, or because it is not known.

    Attributes:
        rows: Number of rows of the table.
        state_names: Names of the n state coordinates of which an error is known in some case; of all if there is none.
        numbers: Numbers of the cases; shape (N,).
        settings: Settings on the axes, by name; the last one is `seed`.
        axes: Settings with at least two levels, without `seed`.
        first_errors: RMSE of deployment 0; shape (N, n).
        last_errors: RMSE of the last deployment; shape (N, n).
        redeployed: Whether the last deployment is not deployment 0; shape (N,).
        aborted: Whether any deployment was aborted by a failed step; shape (N,).
        aborted_last: Whether the last deployment was; shape (N,).
        hops: Number of steps to the band, infinite if it was never reached; shape (N,).
        failed: Cases that failed.
    """

    rows: int
    state_names: tuple[str, ...]
    numbers: LevelCodes
    settings: Mapping[str, SettingTexts]
    axes: tuple[SweepAxis, ...]
    first_errors: Array
    last_errors: Array
    redeployed: NDArray[np.bool_]
    aborted: NDArray[np.bool_]
    aborted_last: NDArray[np.bool_]
    hops: Array
    failed: tuple[FailedCase, ...]

    def __len__(self) -> int:
        return len(self.numbers)

    @property
    def comparable(self) -> NDArray[np.bool_]:
        """Whether the last errors of all coordinates are known and the last deployment was not aborted; shape (N,)."""
        return np.all(np.isfinite(self.last_errors), axis=1)

    @property
    def constants(self) -> dict[str, str]:
        """Value of each setting that has only one in the table."""
        varied = {axis.name for axis in self.axes} | {"seed"}
        return {name: each.of_case(0) for name, each in self.settings.items() if name not in varied and len(self)}


def sweep_cases(table: ResultsTable) -> SweepCases:
    """Makes the cases of a table: the errors of their first and last deployments, and whether a step failed.

    Raises:
        ValueError: The number of a case is not valid.
    """
    columns = table.columns
    numbers = columns["case"]
    if not np.all((numbers >= 0) & (numbers < _LARGEST_CASE) & (numbers == np.floor(numbers))):
        raise ValueError(f"column case must contain integers from 0 to {_LARGEST_CASE - 1}")
    failed = columns["failed"] != ""
    rows = np.flatnonzero(np.logical_not(failed))
    rows = rows[np.lexsort((columns["iteration"][rows], numbers[rows]))]
    starts = np.flatnonzero(np.diff(numbers[rows], prepend=-1))
    first, last = rows[starts], rows[np.append(starts[1:], len(rows)) - 1] if len(rows) else rows
    failed_steps = columns["falls"]
    aborted = np.fmax.reduceat(failed_steps[rows], starts) > 0 if len(rows) else np.zeros(0, bool)
    settings = {name: SettingTexts(*np.unique(columns[name][last], return_inverse=True)) for name in table.settings}
    names = tuple(name for name in table.state_names if np.isfinite(columns[f"rmse_{name}"]).any()) or table.state_names
    hops = columns["hops_to_band"][last]
    return SweepCases(
        len(table),
        names,
        numbers[last].astype(np.int64),
        settings,
        _axes({name: each for name, each in settings.items() if name != "seed"}),
        _errors(table, names, first, (columns["iteration"][first] == 0) & (failed_steps[first] == 0)),
        _errors(table, names, last, failed_steps[last] == 0),
        columns["iteration"][last] > 0,
        aborted,
        failed_steps[last] > 0,
        np.where(np.isfinite(hops), hops, np.inf),
        _failed_cases(table, np.flatnonzero(failed)),
    )


def _errors(table: ResultsTable, names: Sequence[str], rows: LevelCodes, valid: NDArray[np.bool_]) -> Array:
    """Errors of the state coordinates in rows, NaN where they cannot be compared; shape (N, n)."""
    errors = np.stack([table.columns[f"rmse_{name}"][rows] for name in names], axis=1)
    return np.where(valid[:, np.newaxis] & np.isfinite(errors) & (errors > 0), errors, np.nan)


def _failed_cases(table: ResultsTable, rows: LevelCodes) -> tuple[FailedCase, ...]:
    texts = [table.columns[name][rows].tolist() for name in (*table.settings, "failed")]
    numbers = table.columns["case"][rows].astype(int).tolist()
    cases = (FailedCase(number, tuple(values), reason) for number, *values, reason in zip(numbers, *texts, strict=True))
    return tuple(sorted(cases, key=lambda case: case.number))


def _axes(settings: Mapping[str, SettingTexts]) -> tuple[SweepAxis, ...]:
    """Axes of the settings with at least two values; numbers with many values are divided into ranges."""
    axes = [axis for name, each in settings.items() if len((axis := _levels(name, each)).levels) > 1]
    numeric = [axis for axis in axes if axis.values is not None and len(axis.levels) > 2]
    many = [axis for axis in numeric if len(axis.levels) > MOST_LEVELS or _moves_with_another(axis, numeric)]
    if not many:
        return tuple(axes)
    points = np.zeros(len(axes[0].codes), np.int64)
    for axis in many:
        _, points = np.unique(points * len(axis.levels) + axis.codes, return_inverse=True)
    ranges = (points.max() + 1) // (POINTS_PER_RANGE * len(many))
    return tuple(_divided(axis, int(np.clip(ranges, *RANGES)), points) if axis in many else axis for axis in axes)


def _moves_with_another(axis: SweepAxis, axes: Sequence[SweepAxis]) -> bool:
    """Whether each value of a setting always comes with the same value of another, as in a Sobol' sequence."""
    count = len(axis.levels)
    others = [other.codes for other in axes if other is not axis and len(other.levels) == count]
    return any(len(np.unique(axis.codes * count + codes)) == count for codes in others)


def _levels(name: str, setting: SettingTexts) -> SweepAxis:
    """All different values of a setting as levels."""
    found, codes = setting
    numbers = as_numbers(found)
    if name not in NOMINAL and numbers.dtype.kind in "if" and not np.isnan(numbers).any():
        values = numbers.astype(float)[codes]
        found, codes = np.unique(values, return_inverse=True)
        return SweepAxis(name, tuple(f"{value:.10g}" for value in found.tolist()), codes, values)
    order = np.argsort(np.unique(codes, return_index=True)[1])  # that of the cases
    levels = tuple(str(text) or "(empty)" for text in found[order])
    return SweepAxis(name, levels, np.argsort(order)[codes])


def _divided(axis: SweepAxis, ranges: int, points: LevelCodes) -> SweepAxis:
    """The axis of a numeric setting whose levels are ranges with equally many cases."""
    values = np.asarray(axis.values)
    limits = np.quantile(values, np.arange(1, ranges) / ranges, method="higher")
    _, codes = np.unique(np.searchsorted(limits, values, side="right"), return_inverse=True)
    lowest, highest = (_by_level(extreme, values, codes) for extreme in (np.minimum, np.maximum))
    levels = tuple(f"{low:.3g} to {high:.3g}" for low, high in zip(lowest, highest, strict=True))
    return SweepAxis(axis.name, levels, codes, values, points)


def _by_level(extreme: np.ufunc, values: Array, codes: LevelCodes) -> Sequence[float]:
    """Smallest or largest value of each level."""
    order = np.argsort(codes, kind="stable")
    return extreme.reduceat(values[order], np.flatnonzero(np.diff(codes[order], prepend=-1))).tolist()
