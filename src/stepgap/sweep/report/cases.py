"""The cases of a sweep, with one entry each, and the levels of the settings on its axes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stepgap.step import Array
from stepgap.sweep.results_table import ResultsTable, as_numbers

MOST_LEVELS: Final = 16
"""Number of different numbers up to which each is a level; more of them are divided into ranges."""

RANGES: Final = 8
"""Number of ranges with equally many cases into which a setting with many numbers is divided."""

NAMES: Final = ("twin",)  # Settings whose numbers are names, because they have no order

_LARGEST_CASE: Final = 10**8


@dataclass(frozen=True, eq=False)
class SweepAxis:
    """A setting with at least two different values in N cases.

    Attributes:
        name: Name of the setting.
        levels: Texts of its L levels: numbers or ranges of numbers ascend, names are in the order of the cases.
        codes: Level of each case; shape (N,).
    """

    name: str
    levels: tuple[str, ...]
    codes: NDArray[np.int64]

    def quartiles(self, values: Array) -> Array:
        """Quartiles of the values at each level, NaN where none is known; shape (3, L).

        Args:
            values: Values of the cases, infinite or NaN where unknown; shape (N,).
        """
        quartiles = np.full((3, len(self.levels)), np.nan)
        for level in range(len(self.levels)):
            of_level = values[self.codes == level]
            numbers = of_level[~np.isnan(of_level)]
            if len(numbers):
                quartiles[:, level] = np.quantile(numbers, [0.25, 0.5, 0.75], method="inverted_cdf")
        return quartiles


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
        settings: Texts of the settings on the axes, by name, each of shape (N,); the last one is `seed`.
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
    numbers: NDArray[np.int64]
    settings: Mapping[str, NDArray[Any]]
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
        return {name: str(texts[0]) for name, texts in self.settings.items() if name not in varied and len(self)}


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

    # the rows of the first and of the last deployment of each case
    rows = np.flatnonzero(~failed)
    rows = rows[np.lexsort((columns["iteration"][rows], numbers[rows]))]
    starts = np.flatnonzero(np.diff(numbers[rows], prepend=-1))
    first = rows[starts]
    last = rows[np.append(starts[1:], len(rows)) - 1] if len(rows) else rows

    failed_steps = columns["falls"]
    aborted = np.fmax.reduceat(failed_steps[rows], starts) > 0 if len(rows) else np.zeros(0, bool)
    settings = {name: columns[name][last] for name in table.settings}
    names = tuple(name for name in table.state_names if np.isfinite(columns[f"rmse_{name}"]).any()) or table.state_names
    hops = columns["hops_to_band"][last]
    return SweepCases(
        len(table),
        names,
        numbers[last].astype(np.int64),
        settings,
        tuple(_axes(settings)),
        _errors(table, names, first, (columns["iteration"][first] == 0) & (failed_steps[first] == 0)),
        _errors(table, names, last, failed_steps[last] == 0),
        columns["iteration"][last] > 0,
        aborted,
        failed_steps[last] > 0,
        np.where(np.isfinite(hops), hops, np.inf),
        _failed_cases(table, np.flatnonzero(failed)),
    )


def _errors(table: ResultsTable, names: Sequence[str], rows: NDArray[np.int64], valid: NDArray[np.bool_]) -> Array:
    """Errors of the state coordinates in rows, NaN where they cannot be compared; shape (N, n)."""
    errors = np.stack([table.columns[f"rmse_{name}"][rows] for name in names], axis=1)
    return np.where(valid[:, np.newaxis] & np.isfinite(errors) & (errors > 0), errors, np.nan)


def _failed_cases(table: ResultsTable, rows: NDArray[np.int64]) -> tuple[FailedCase, ...]:
    texts = [table.columns[name][rows].tolist() for name in (*table.settings, "failed")]
    numbers = table.columns["case"][rows].astype(int).tolist()
    cases = (FailedCase(number, tuple(values), reason) for number, *values, reason in zip(numbers, *texts, strict=True))
    return tuple(sorted(cases, key=lambda case: case.number))


def _axes(settings: Mapping[str, NDArray[Any]]) -> list[SweepAxis]:
    axes = [_levels(name, texts) for name, texts in settings.items() if name != "seed"]
    return [axis for axis in axes if len(axis.levels) > 1]


def _levels(name: str, texts: NDArray[Any]) -> SweepAxis:
    """The levels of a setting: its different values, or ranges of many numbers."""
    different, codes = np.unique(texts, return_inverse=True)
    numbers = as_numbers(different)
    if name in NAMES or numbers.dtype.kind not in "if" or np.isnan(numbers).any():
        order = np.argsort(np.unique(codes, return_index=True)[1])  # that of the cases
        return SweepAxis(name, tuple(str(text) or "(empty)" for text in different[order]), np.argsort(order)[codes])
    values = numbers.astype(float)[codes]
    numbers, codes = np.unique(values, return_inverse=True)
    if len(numbers) <= MOST_LEVELS:
        return SweepAxis(name, tuple(f"{value:.10g}" for value in numbers.tolist()), codes)
    limits = np.quantile(values, np.arange(1, RANGES) / RANGES, method="higher")
    _, codes = np.unique(np.searchsorted(limits, values, side="right"), return_inverse=True)
    parts = [values[codes == level] for level in range(codes.max() + 1)]
    return SweepAxis(name, tuple(f"{part.min():.3g} to {part.max():.3g}" for part in parts), codes)
