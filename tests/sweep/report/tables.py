"""Tables of sweeps for tests, and cases without a file."""

from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path

import numpy as np

from stepgap.records.summary import MEASURES
from stepgap.step import Array, Quantity, StepSpace
from stepgap.sweep.report.cases import SweepCases, sweep_cases
from stepgap.sweep.results_table import RESULTS, columns_of, read_results, table_text

STATE = ("speed", "height")


def combinations_of(axes: Mapping[str, Sequence[object]]) -> dict[str, list[str]]:
    """The settings of all combinations, as columns of texts; the last one changes fastest."""
    rows = list(product(*axes.values()))
    return {name: [str(row[column]) for row in rows] for column, name in enumerate(axes)}


def write_results_table(
    folder: Path,
    settings: Mapping[str, Sequence[str]],
    errors: Array,
    *,
    aborted: Mapping[int, int] | None = None,
    hops: Mapping[int, int] | None = None,
    failed: Mapping[int, str] | None = None,
    names: Sequence[str] = STATE,
) -> Path:
    """Writes the table of a sweep and returns its folder.

    Args:
        folder: The folder, which is created.
        settings: Texts of the settings, each with N values; the last one is `seed`.
        errors: RMSE by case, deployment and state coordinate; shape (N, D, n).
        aborted: Deployment that was aborted, by case.
        hops: Hops to the band, by case.
        failed: Reasons of failed cases.
        names: Names of the state coordinates.
    """
    aborted, hops, failed = aborted or {}, hops or {}, failed or {}
    space = StepSpace(tuple(Quantity(name, "", -1, 1) for name in names), (Quantity("push", "N", -1, 1),))
    rows = []
    for case in range(len(errors)):
        before = [str(case), *(texts[case] for texts in settings.values())]
        if case in failed:
            rows.append([*before, *[""] * (5 + len(MEASURES) * len(names)), failed[case]])
            continue
        for number, values in enumerate(errors[case]):
            texts = ["" if np.isnan(value) else repr(float(value)) for value in np.tile(values, len(MEASURES))]
            known = str(hops[case]) if case in hops and number == len(errors[case]) - 1 else ""
            falls = str(int(aborted.get(case) == number))
            rows.append([*before, str(number), "gp" if number else "none", "30", falls, *texts, known, ""])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / RESULTS).write_text(table_text(columns_of(list(settings), space), rows), encoding="utf-8")
    return folder


def cases_in(folder: Path) -> SweepCases:
    """The cases of the table in a folder."""
    return sweep_cases(read_results(folder / RESULTS))


def cases_of(folder: Path, settings: Mapping[str, Sequence[str]], logs: Array) -> SweepCases:
    """Cases whose last errors have these logarithms, shape (N,) or (N, n); those of deployment 0 are 1."""
    last = np.exp(logs.reshape(len(logs), -1))
    errors = np.stack([np.ones_like(last), last], axis=1)
    return cases_in(write_results_table(folder, settings, errors, names=STATE[: last.shape[1]]))
