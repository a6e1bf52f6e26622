"""Tables of a sweep: the statistics of the levels of each axis."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from stepgap.records.text import decimal, with_unit
from stepgap.report.html import table
from stepgap.report.settings_table import DASH
from stepgap.step import Quantity
from stepgap.sweep.report.cases import LevelCodes, SweepAxis, SweepCases
from stepgap.sweep.report.levels import Estimates, level_means, matched_groups, paired_ratios, quartiles

MOST_ROWS: Final = 20
"""Largest number of rows of a table."""


def level_table(cases: SweepCases, axis: SweepAxis, state: Sequence[Quantity]) -> str:
    """HTML table of the levels of an axis: errors, ratios to the first, aborted deployments and steps to the band."""
    count = len(axis.levels)
    columns = {"cases": _numbers(axis.codes, count)}
    for index, quantity in enumerate(state):
        means = level_means(axis, cases.last_errors[:, index])
        columns[f"last RMSE of {with_unit(quantity)}"] = [_with_interval(means, row) for row in range(count)]
    columns["aborted"] = _numbers(axis.codes[cases.aborted], count)
    if np.isfinite(cases.hops).any():
        columns["steps to band (median)"] = list(map(_hops, quartiles(cases.hops, axis.codes, count)[1]))
    for quantity, ratios in zip(state, _ratios(cases, axis), strict=False):
        columns["pairs"] = [DASH, *map(str, ratios.counts[1:])]
        cells = ["1", *(_with_interval(ratios, row) for row in range(1, count))]
        columns[f"ratio of {quantity.name} error to first level"] = cells
    rows = list(zip(axis.levels, *columns.values(), strict=True))
    more = f" (the first {MOST_ROWS} of {count} levels)" if count > MOST_ROWS else ""
    return table(f"{axis.name}{more}", ["level", *columns], rows[:MOST_ROWS])


def _numbers(codes: LevelCodes, levels: int) -> list[str]:
    """Number of cases at each level."""
    return list(map(str, np.bincount(codes, minlength=levels)))


def _ratios(cases: SweepCases, axis: SweepAxis) -> list[Estimates]:
    """Ratios of the errors of each state coordinate to those at the first level; none if there are no matched pairs."""
    if axis.points is not None:
        return []
    errors = np.where(cases.comparable[:, np.newaxis], cases.last_errors, np.nan)
    groups = matched_groups(cases, axis)
    found = [paired_ratios(groups, axis, each) for each in errors.T]
    return found if found[0].counts[1:].any() else []


def _with_interval(found: Estimates, row: int) -> str:
    """An estimate, with its interval if that is known."""
    if not found.counts[row]:
        return DASH
    ends = [decimal(end[row]) for end in (found.lower, found.upper)]
    return decimal(found.values[row]) + (f" ({ends[0]}–{ends[1]})" if np.isfinite(found.upper[row]) else "")


def _hops(value: float) -> str:
    return "never" if np.isposinf(value) else DASH if np.isnan(value) else f"{value:.0f}"
