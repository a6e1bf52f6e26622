"""Comparison of several runs on one page: their errors side by side, one figure, and the settings that differ."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

import numpy as np

from stepgap.records.run_folder import RunRecord
from stepgap.report.decimals import decimal
from stepgap.report.drawing import draw_figure
from stepgap.report.error_table import steps_in_words
from stepgap.report.html import bullets, page, paragraph, picture, section, table
from stepgap.report.seed_spread import spread_tables
from stepgap.report.sentences import end_in_a_word, headline
from stepgap.report.settings_table import DASH, differing, flat_settings
from stepgap.report.units import with_unit
from stepgap.step import Array

MOST_RUNS: Final = 12
"""Largest number of runs on one page, so that their curves can be distinguished."""

COMPARED: Final = {"rmse": "RMSE", "steady_rmse": "steady RMSE", "transient_rmse": "transient RMSE"}
"""Compared errors, with their labels."""

CAPTION: Final = (
    "Root-mean-square tracking error of each run by deployment, on a logarithmic axis. An aborted deployment is "
    "counted up to its last completed step."
)

TRACKING_CAPTION: Final = (
    "Tracking in the last deployment of each run: the state at the end of each step, and the reference."
)

SPREAD_NOTE: Final = (
    "These runs have the same settings and versions, except the seed, so they repeat one experiment: their spread is "
    "that of its random influences. Geometric means; their intervals count the runs as independent."
)


def comparison_html(records: Sequence[RunRecord]) -> str:
    """HTML of the comparison page.

    Args:
        records: At least two runs.

    Raises:
        ValueError: There are too few or too many runs, or their states differ.
    """
    _check(records)
    names = run_names([record.folder for record in records])

    def errors() -> object:
        from stepgap.report.figures import comparison_figure

        return comparison_figure(records, names)

    def tracking() -> object:
        from stepgap.report.figures import comparison_tracking_figure

        return comparison_tracking_figure(records, names)

    pictures = [picture(draw_figure(errors, "the errors"), "errors-", CAPTION)]
    if same_reference(records):
        pictures.append(picture(draw_figure(tracking, "the tracking"), "tracking-", TRACKING_CAPTION))
    spreads = spread_tables(records, names)
    return page(
        "StepGap comparison",
        [
            f"<h1>StepGap comparison of {len(records)} runs</h1>",
            bullets([f"{name}: {headline(record)}" for name, record in zip(names, records, strict=True)]),
            section("figure", "Figures", *pictures),
            *(
                [section("spread", "Spread over seeds", paragraph(SPREAD_NOTE), _side_by_side(spreads))]
                if spreads
                else []
            ),
            section(
                "numbers",
                "Errors by deployment",
                paragraph(_references(records)),
                _side_by_side(_tables(records, names)),
            ),
            section("settings", "Settings and versions that differ", _settings(records, names)),
        ],
    )


def _check(records: Sequence[RunRecord]) -> None:
    """Raises ValueError unless the runs can be compared."""
    if not 2 <= len(records) <= MOST_RUNS:
        raise ValueError(f"{len(records)} runs to compare, but there must be 2 to {MOST_RUNS}")
    first = records[0]
    for record in records:
        if record.space.state_names != first.space.state_names:
            raise ValueError(
                f"{record.folder}: its state is {', '.join(record.space.state_names)}, but that of {first.folder} is "
                f"{', '.join(first.space.state_names)}; only runs of the same state can be compared"
            )


def _side_by_side(tables: Sequence[str]) -> str:
    return f'<div class="tables">{"".join(tables)}</div>'


def run_names(folders: Sequence[Path]) -> list[str]:
    """Short names of folders: their paths without the common part."""
    paths = [folder.resolve() for folder in folders]
    shared = os.path.commonpath([path.parent for path in paths])
    names = [str(path.relative_to(shared)) for path in paths]
    return [name if names.count(name) == 1 else f"{name} ({row + 1})" for row, name in enumerate(names)]


def same_reference(records: Sequence[RunRecord]) -> bool:
    """Whether the runs tracked the same reference, as far as all of them tracked it."""
    targets = [record.steps.of_iteration(record.shown_iterations[0]).tracking().target for record in records]
    shortest = min(map(len, targets))
    return all(np.array_equal(each[:shortest], targets[0][:shortest]) for each in targets)


def _references(records: Sequence[RunRecord]) -> str:
    """Sentence on whether the runs have the same reference, so that their errors can be compared."""
    if same_reference(records):
        return "All runs tracked the same reference. Errors are next state − target."
    return "These runs tracked different references: compare trends, not numbers. Errors are next state − target."


def _tables(records: Sequence[RunRecord], names: Sequence[str]) -> list[str]:
    numbers = sorted({entry.iteration for record in records for entry in record.deployments})
    entries = [{entry.iteration: entry for entry in record.deployments} for record in records]
    found = []
    for measure, label in COMPARED.items():
        for index, quantity in enumerate(records[0].space.state):
            rows = [
                [
                    str(number),
                    *(decimal(each[number].errors[measure][index]) if number in each else DASH for each in entries),
                ]
                for number in numbers
            ]
            found.append(table(f"{label} of {with_unit(quantity)}", ["deployment", *names], rows))
    rows = [
        [
            str(number),
            *(
                f"{each[number].steps}, {end_in_a_word(record, each[number])}" if number in each else DASH
                for record, each in zip(records, entries, strict=True)
            ),
        ]
        for number in numbers
    ]
    found.append(table("Steps, and how the deployment ended", ["deployment", *names], rows))
    results = [record.compared_result for record in records]
    if len({result and result.source for result in results}) == 1 and results[0]:
        caption = f"Number of steps, exploratory ones included, until the error stays in {results[0].source}'s band"
        steps = [_to_band(record, results[0].band) for record in records]
        found.append(table(caption, ["", *names], [["steps", *steps]]))
    return found


def _to_band(record: RunRecord, band: Array) -> str:
    """Number of steps until the error stays in the band, over all deployments of a run."""
    if not record.deployments:
        return DASH
    logs = [record.steps.of_iteration(entry.iteration) for entry in record.deployments]
    return steps_in_words(logs, band, end_in_a_word(record, record.deployments[-1]))


def _settings(records: Sequence[RunRecord], names: Sequence[str]) -> str:
    columns = [
        flat_settings(record.settings.table if record.settings else {})
        | {f"version of {name}": text for name, text in record.summary.versions}
        for record in records
    ]
    without = [name for name, record in zip(names, records, strict=True) if record.settings is None]
    note = paragraph(f"No experiment.toml in: {', '.join(without)}.") if without else ""
    rows = differing(columns)
    if not rows:
        return note or paragraph("None: these runs were made with the same settings and versions.")
    return note + table("", ["setting", *names], rows)
