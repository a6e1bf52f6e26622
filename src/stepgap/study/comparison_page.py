"""Comparison of several runs on one page: their errors side by side, one figure, and the settings that differ."""

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from scipy.special import stdtrit

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.records.summary import Deployment
from stepgap.records.text import decimal, with_unit
from stepgap.report.drawing import BLACK, BLUE, LIGHT, VERMILLION, axis_label, draw_figure, plain
from stepgap.report.html import bullets, page, paragraph, picture, section, table
from stepgap.report.plots import (
    as_pixels,
    draw_tracking,
    drawn_values,
    finish,
    log_scale,
    show_steps,
    step_numbers,
    step_panels,
    write_note,
)
from stepgap.report.sentences import end_in_a_word, headline
from stepgap.report.tables import DASH, differing, flat_settings, steps_in_words
from stepgap.step import Array

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

MOST_RUNS: Final = 12  # Largest number of runs on one page, so that their curves can be distinguished

COMPARED: Final = {"rmse": "RMSE", "steady_rmse": "steady RMSE", "transient_rmse": "transient RMSE"}
"""Compared errors, with their labels."""

_CAPTION: Final = "Root-mean-square tracking error of each run by deployment, on a logarithmic axis."

ABORTED: Final = " An aborted deployment is counted up to its last completed step."

TRACKING_CAPTION: Final = (
    "Tracking in the last deployment of each run: the state at the end of each step, and the reference."
)

RUN_COLOURS: Final = (BLUE, VERMILLION, BLACK, "#009E73", "#CC79A7")
RUN_MARKERS: Final = ("o", "s", "^", "D", "v", "x", "P")
RUN_LINES: Final = ("-", "--", "-.", ":")

FEWEST_SEEDS: Final = 3  # Smallest number of seeds whose spread is shown

_NO_INFLUENCE: Final = ("seed", "name", "note")  # Settings in which runs that repeat one experiment may differ

SPREAD_NOTE: Final = (
    "These runs have the same settings and versions, except the seed, so they repeat one experiment: their spread is "
    "that of its random influences. Geometric means; their intervals count the runs as independent."
)


def comparison_html(runs: Sequence[Run], before: Sequence[str] = ()) -> str:
    """HTML of the comparison page.

    Args:
        runs: At least two runs.
        before: HTML of sections that come before those on the errors.

    Raises:
        InputError: There are too few or too many runs, or their states differ.
    """
    check_comparable(runs)
    names = run_names([run.folder for run in runs])

    aborted = any(entry.failed_steps for run in runs for entry in run.deployments)
    caption = _CAPTION + ABORTED * aborted
    pictures = [picture(draw_figure(lambda: comparison_figure(runs, names), "the errors"), "errors-", caption)]
    if same_reference(runs):
        drawing = draw_figure(lambda: comparison_tracking_figure(runs, names), "the tracking")
        pictures.append(picture(drawing, "tracking-", TRACKING_CAPTION))
    called = [f" ({run.called})" if run.called else "" for run in runs]
    headlines = [f"{name}: {headline(run)}{text}" for name, run, text in zip(names, runs, called, strict=True)]
    sections = [*before, section("figure", "Figures", *pictures)]
    if spreads := spread_tables(runs, names):
        parts = paragraph(SPREAD_NOTE), _side_by_side(spreads)
        sections.append(section("spread", "Spread over seeds", *parts))
    parts = paragraph(_references(runs)), _side_by_side(_tables(runs, names))
    sections.append(section("numbers", "Errors by deployment", *parts))
    sections.append(section("settings", "Settings and versions that differ", _settings(runs, names)))
    title = f"<h1>StepGap comparison of {len(runs)} runs</h1>"
    return page("StepGap comparison", [title, bullets(headlines), *sections])


def check_comparable(runs: Sequence[Run]) -> None:
    """Raises InputError unless the errors of the runs can be compared."""
    if not 2 <= len(runs) <= MOST_RUNS:
        raise InputError(f"{len(runs)} runs to compare, but there must be 2 to {MOST_RUNS}")
    first = runs[0]
    for run in runs:
        if run.space.state_names != first.space.state_names:
            raise InputError(
                f"{run.folder}: its state is {', '.join(run.space.state_names)}, but that of {first.folder} is "
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


def same_reference(runs: Sequence[Run]) -> bool:
    """Whether the runs tracked the same reference, as far as all of them tracked it."""
    targets = [run.steps.of_iteration(run.shown_iterations[0]).tracking().target for run in runs]
    shortest = min(map(len, targets))
    return all(np.array_equal(of_run[:shortest], targets[0][:shortest], equal_nan=True) for of_run in targets)


def _tracked(runs: Sequence[Run]) -> list[int]:
    """Numbers of the state coordinates, from 0, that have targets in some run; all if there are no targets yet."""
    return sorted({row for run in runs for row in run.steps.tracking().tracked}) or list(
        range(len(runs[0].space.state))
    )


def _references(runs: Sequence[Run]) -> str:
    """Sentence on whether the runs have the same reference, so that their errors can be compared."""
    if same_reference(runs):
        return "All runs tracked the same reference. Errors are next state − target."
    return "These runs tracked different references: compare trends, not numbers. Errors are next state − target."


def _tables(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    tables = [
        _by_deployment(
            f"{label} of {with_unit(runs[0].space.state[index])}",
            runs,
            names,
            lambda _, entry, measure=measure, index=index: decimal(entry.errors[measure][index]),
        )
        for measure, label in COMPARED.items()
        for index in _tracked(runs)
    ]
    title = "Steps, and how the deployment ended"
    tables.append(_by_deployment(title, runs, names, lambda run, entry: f"{entry.steps}, {end_in_a_word(run, entry)}"))
    results = [run.compared_result for run in runs]
    if len({result and result.source for result in results}) == 1 and results[0]:
        caption = f"Number of steps, exploratory ones included, until the error stays in {results[0].source}'s band"
        steps = [_to_band(run, results[0].band) for run in runs]
        tables.append(table(caption, ["", *names], [["steps", *steps]]))
    return tables


def _by_deployment(
    title: str, runs: Sequence[Run], names: Sequence[str], cell: Callable[[Run, Deployment], str]
) -> str:
    """Table with a row for each deployment and a column for each run."""
    rows = dict[int, list[str]]()
    for column, run in enumerate(runs):
        for entry in run.deployments:
            rows.setdefault(entry.iteration, [DASH] * len(runs))[column] = cell(run, entry)
    return table(title, ["deployment", *names], [[str(number), *cells] for number, cells in sorted(rows.items())])


def _to_band(run: Run, band: Array) -> str:
    """Number of steps until the error stays in the band, over all deployments of a run."""
    if not run.deployments:
        return DASH
    logs = [run.steps.of_iteration(entry.iteration) for entry in run.deployments]
    return steps_in_words(logs, band, end_in_a_word(run, run.deployments[-1]))


def _settings(runs: Sequence[Run], names: Sequence[str]) -> str:
    columns = [
        flat_settings({} if isinstance(run.settings_file, Missing) else run.settings_file.table)
        | {f"version of {name}": text for name, text in run.summary.versions}
        for run in runs
    ]
    without = [name for name, run in zip(names, runs, strict=True) if isinstance(run.settings_file, Missing)]
    note = paragraph(f"No experiment.toml in: {', '.join(without)}.") if without else ""
    rows = differing(columns)
    if not rows:
        return note or paragraph("None: these runs were made with the same settings and versions.")
    return note + table("", ["setting", *names], rows)


def spread_tables(runs: Sequence[Run], names: Sequence[str]) -> list[str]:
    """Tables of the RMSE over seeds, for each group of runs that differ in the seed only, and each state coordinate."""
    return [
        _spread_table([runs[row] for row in group], [names[row] for row in group], index)
        for group in seed_groups(runs)
        for index in _tracked(runs)
    ]


def seed_groups(runs: Sequence[Run]) -> list[list[int]]:
    """Indices of runs with the same settings and versions, but with at least `FEWEST_SEEDS` different seeds."""
    groups: dict[object, dict[int | None, int]] = {}
    for row, run in enumerate(runs):
        if not isinstance(run.settings_file, Missing):
            entries = run.settings_file.table.items()
            settings = flat_settings({name: value for name, value in entries if name not in _NO_INFLUENCE})
            key = tuple(sorted(settings.items())), run.summary.versions
            groups.setdefault(key, {}).setdefault(run.summary.seed, row)
    return [list(rows.values()) for rows in groups.values() if len(rows) >= FEWEST_SEEDS]


def _spread_table(runs: Sequence[Run], names: Sequence[str], index: int) -> str:
    numbers = sorted({entry.iteration for run in runs for entry in run.deployments})
    rows = []
    for number in numbers:
        entries = [entry for run in runs for entry in run.deployments if entry.iteration == number]
        errors = np.array([entry.errors["rmse"][index] for entry in entries])
        rows.append([str(number), *_spread(errors[np.isfinite(errors)])])
    return table(
        f"Spread over seeds of the RMSE of {with_unit(runs[0].space.state[index])}: {', '.join(names)}",
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


def comparison_figure(runs: Sequence[Run], names: Sequence[str]) -> "Figure":
    """RMSE of the tracked coordinates by deployment, with a curve for each run."""
    rows = _tracked(runs)
    figure, panels = step_panels(len(rows))
    for row, (run, name) in enumerate(zip(runs, names, strict=True)):
        numbers = [deployment.iteration for deployment in run.deployments]
        marker = RUN_MARKERS[row % len(RUN_MARKERS)]
        for index, panel in zip(rows, panels, strict=True):
            values = [deployment.errors["rmse"][index] for deployment in run.deployments]
            if np.isfinite(values).any():
                panel.plot(numbers, values, **_look(row), marker=marker, label=plain(name))
    for panel, index in zip(panels, rows, strict=True):
        panel.set_ylabel(f"RMSE of\n{axis_label(runs[0].space.state[index], capital=False)}")
        log_scale(panel, drawn_values(panel))
        if not panel.lines:
            write_note(panel, "There is no error yet.")
    finish(figure, panels, "Deployment")
    return figure


def _look(row: int) -> dict[str, Any]:
    """Colour and line of a run."""
    return {"color": RUN_COLOURS[row % len(RUN_COLOURS)], "linestyle": RUN_LINES[row % len(RUN_LINES)]}


def comparison_tracking_figure(runs: Sequence[Run], names: Sequence[str]) -> "Figure":
    """State coordinates against the step number in the last deployment of each run, with the reference of the longest.

    The runs must have the same reference.
    """
    state = runs[0].space.state
    figure, panels = step_panels(len(state))
    last = [run.steps.of_iteration(run.shown_iterations[-1]).tracking() for run in runs]
    longest = max(last, key=len)
    show_steps(panels, longest)
    for index, (panel, quantity) in enumerate(zip(panels, state, strict=True)):
        reference = {"color": LIGHT, "linewidth": 3.5, "drawstyle": "steps-mid", "label": "reference"}
        panel.plot(step_numbers(longest), longest.target[:, index], **reference, **as_pixels(longest))
        for row, (steps, name) in enumerate(zip(last, names, strict=True)):
            draw_tracking(panel, steps, index, plain(name), {**_look(row), "linewidth": 0.8, **as_pixels(steps)})
        panel.set_ylabel(axis_label(quantity))
    finish(figure, panels, "Step")
    return figure
