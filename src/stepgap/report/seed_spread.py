"""The spread of errors over seeds: runs with the same settings, except the seed, are repetitions of one experiment."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.special import stdtrit

from stepgap.records.run_folder import RunRecord
from stepgap.report.decimals import decimal
from stepgap.report.html import table
from stepgap.report.settings_table import flat_settings
from stepgap.report.units import with_unit
from stepgap.step import Array

FEWEST_SEEDS: Final = 3
"""Smallest number of seeds whose spread is shown."""


def spread_tables(records: Sequence[RunRecord], names: Sequence[str]) -> list[str]:
    """Tables of the RMSE over seeds, for each group of runs that differ in the seed only, and each state coordinate."""
    return [
        _spread_table([records[row] for row in group], [names[row] for row in group], index)
        for group in seed_groups(records)
        for index in range(len(records[0].space.state))
    ]


def seed_groups(records: Sequence[RunRecord]) -> list[list[int]]:
    """Indices of runs with the same settings and versions, but with at least `FEWEST_SEEDS` different seeds."""
    groups: dict[object, dict[int | None, int]] = {}
    for row, record in enumerate(records):
        if record.settings is not None:
            settings = flat_settings({name: v for name, v in record.settings.table.items() if name != "seed"})
            key = tuple(sorted(settings.items())), record.summary.versions
            groups.setdefault(key, {}).setdefault(record.summary.seed, row)
    return [list(rows.values()) for rows in groups.values() if len(rows) >= FEWEST_SEEDS]


def _spread_table(records: Sequence[RunRecord], names: Sequence[str], index: int) -> str:
    numbers = sorted({entry.iteration for record in records for entry in record.deployments})
    rows = []
    for number in numbers:
        entries = [entry for record in records for entry in record.deployments if entry.iteration == number]
        errors = np.array([entry.errors["rmse"][index] for entry in entries])
        rows.append([str(number), *_spread(errors[np.isfinite(errors)])])
    return table(
        f"Spread over seeds of the RMSE of {with_unit(records[0].space.state[index])}: {', '.join(names)}",
        ["deployment", "runs", "geometric mean", "95 % interval of the mean", "smallest", "largest"],
        rows,
    )


def _spread(errors: Array) -> list[str]:
    """Cells: number of errors, geometric mean with Student's interval of the mean logarithm, smallest and largest."""
    count = len(errors)
    if not count or not (errors > 0).all():
        return [str(count), *["–"] * 4]
    logs = np.log(errors)
    half = stdtrit(count - 1, 0.975) * logs.std(ddof=1) / np.sqrt(count) if count > 1 else np.nan
    ends = [decimal(float(np.exp(logs.mean() + sign * half))) for sign in (-1, 1)]
    interval = f"{ends[0]} … {ends[1]}" if count > 1 else "–"
    extremes = (decimal(float(value)) for value in (errors.min(), errors.max()))
    return [str(count), decimal(float(np.exp(logs.mean()))), interval, *extremes]
