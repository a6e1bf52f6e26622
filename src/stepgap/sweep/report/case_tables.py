"""Tables of single cases of a sweep: those with the largest errors, those that were aborted, and those that failed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.records.text import decimal, with_unit
from stepgap.report.html import paragraph, table
from stepgap.step import Quantity
from stepgap.sweep.report.cases import LevelCodes, SweepCases

MOST_WORST: Final = 10
"""Number of cases in a table of the worst ones."""

MOST_FAILED: Final = 20
"""Number of failed cases in their table."""

_LONGEST_CELL: Final = 40


def worst_cases(cases: SweepCases, folder: Path, state: Sequence[Quantity]) -> str:
    """HTML tables of the cases with the largest last errors, and of those whose last deployment was aborted.

    Args:
        cases: The cases.
        folder: Folder of the sweep, with the kept runs.
        state: State coordinates.
    """
    sizes = np.log(cases.last_errors).mean(axis=1)
    known = np.flatnonzero(cases.comparable)
    largest = known[np.argsort(-sizes[known], kind="stable")][:MOST_WORST]
    aborted = np.flatnonzero(cases.aborted_last)
    parts = []
    if len(largest):
        coordinates = "" if len(state) == 1 else ", by the geometric mean over the coordinates"
        caption = f"The {len(largest)} largest errors of the last deployment{coordinates}"
        columns = {
            f"last RMSE of {with_unit(quantity)}": list(map(decimal, cases.last_errors[largest, index]))
            for index, quantity in enumerate(state)
        }
        earlier = {"earlier deployment aborted": ["yes" if cases.aborted[row] else "no" for row in largest]}
        parts.append(
            _table(caption, cases, largest, folder, columns | (earlier if cases.aborted[largest].any() else {}))
        )
    if len(aborted):
        more = f" (the first {MOST_WORST} of {len(aborted)})" if len(aborted) > MOST_WORST else ""
        parts.append(_table(f"Cases whose last deployment was aborted{more}", cases, aborted[:MOST_WORST], folder, {}))
    return "\n".join([*parts, paragraph(_how_to_see(cases, folder, [*largest, *aborted[:MOST_WORST]]))])


def failed_cases(cases: SweepCases) -> str:
    """HTML table of the failed cases with the reasons; empty if there is none."""
    if not cases.failed:
        return ""
    rows = [[str(case.number), case.reason, *map(_short, case.settings)] for case in cases.failed[:MOST_FAILED]]
    more = len(cases.failed) - len(rows)
    caption = f"The first {len(rows)} failed cases; {more} more failed" if more else "Failed cases"
    return table(caption, ["case", "reason", *cases.settings], rows)


def _table(
    caption: str, cases: SweepCases, chosen: LevelCodes, folder: Path, columns: Mapping[str, Sequence[str]]
) -> str:
    """HTML table of chosen cases: their settings, and further columns by their heads."""
    names = [name for name in cases.settings if name not in cases.constants]
    numbers = cases.numbers[chosen].tolist()
    cells = [
        list(map(str, numbers)),
        *([_short(cases.settings[name].of_case(row)) for row in chosen] for name in names),
        *columns.values(),
    ]
    links = {str(number): link for number in numbers if (link := _kept(folder, number))}
    return table(caption, ["case", *names, *columns], list(zip(*cells, strict=True)), links)


def _kept(folder: Path, number: int) -> str:
    """Relative path of the report of a case or, if there is none, of its folder; empty if that was not kept."""
    run = f"runs/{number:08d}"
    if (folder / run / "report.html").is_file():
        return f"{run}/report.html"
    return f"{run}/" if (folder / run).is_dir() else ""


def _how_to_see(cases: SweepCases, folder: Path, chosen: Sequence[int]) -> str:
    """Sentence on how to make the report of one of these cases."""
    kept = [run for row in chosen if (folder / (run := f"runs/{cases.numbers[row]:08d}")).is_dir()]
    if not kept:
        return 'The runs of these cases were not kept; keep = "runs" in the file of the sweep keeps them.'
    return (
        "The number of a case leads to its report or, if it has none yet, to its folder. In the folder of the sweep, "
        f"this command makes the report of a case: stepgap report {kept[0]}"
    )


def _short(text: str) -> str:
    return (text if len(text) <= _LONGEST_CELL else f"{text[: _LONGEST_CELL - 1]}…") or "(empty)"
