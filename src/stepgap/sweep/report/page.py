"""The report of a sweep: the page `report.html` and its figure."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError, message_of
from stepgap.base.files import write_whole
from stepgap.experiment.displays import FolderReport, WrittenReport
from stepgap.experiment.settings import Experiment, SettingsFile, experiment_table, read_experiment, read_settings_file
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised, decimal, unit_suffix, with_unit
from stepgap.report.drawing import Drawing, draw_figure, has_figures, write_figures
from stepgap.report.html import bullets, page, paragraph, picture, safe, section, table
from stepgap.report.tables import changed_settings
from stepgap.robots.entry_points import load_robot
from stepgap.step import Array, Quantity, StepSpace
from stepgap.sweep.report.cases import SweepAxis, SweepCases, sweep_cases
from stepgap.sweep.results_table import RESULTS, read_results
from stepgap.sweep.sweep import SWEEP_FILE
from stepgap.sweep.sweep_file import read_sweep

MOST_AXES: Final = 8  # Number of axes whose levels are drawn
MOST_ROWS: Final = 20  # Number of rows of a table of levels or of failed cases
MOST_WORST: Final = 10  # Number of cases in a table of the worst ones
LONGEST_CELL: Final = 40  # Longest text of a setting in a table of cases [characters]

_CAPTION: Final = (
    "RMSE by the value of each setting, whatever the other settings: median of the cases with this value of which that "
    "deployment was not aborted, with a bar between the quartiles. A setting with many values is divided into ranges "
    "with equally many cases."
)
LEVELS_NOTE: Final = (
    "Medians over the cases with this value; further statistics: results.csv, for example with pandas. Steps to the "
    "band count those of all deployments; a case that did not reach it counts as never."
)


def is_sweep(folder: Path) -> bool:
    """Whether a folder holds a sweep, not a run."""
    return not (folder / "steps.csv").exists() and any((folder / name).exists() for name in (RESULTS, SWEEP_FILE))


def report_sweep(folder: Path, figures: bool = False) -> WrittenReport:
    """Writes `report.html` of a sweep, finished or not, and on demand `figures/levels.png` and `figures/levels.pdf`.

    Args:
        folder: Folder of the sweep, with `results.csv`.
        figures: Whether to write the files of the figures, too.

    Raises:
        InputError: The content of a file is wrong, or the report cannot be written.
    """
    path = folder / RESULTS
    if not path.is_file():
        raise InputError(f"{path}: no such file; this makes it: stepgap sweep --out {folder} --resume")
    try:
        return _write_report(folder, sweep_cases(read_results(path)), figures)
    except ValueError as error:
        raise InputError(str(error) if str(folder) in str(error) else f"{path}: {error}") from None
    except OSError as error:
        raise InputError(message_of(error)) from None


def _write_report(folder: Path, cases: SweepCases, figures: bool) -> WrittenReport:
    defaults, space = _base(folder / "experiment.toml")
    quantities = {quantity.name: quantity for quantity in space.state} if space else {}
    state = [quantities.get(name) or Quantity(name, "", -1, 1) for name in cases.state_names]
    settings = read_settings_file(folder / "experiment.toml")
    drawing = _level_drawing(cases, state)
    if drawing and (figures or has_figures(folder)):
        write_figures(folder, {"levels": drawing})
    title = f"StepGap report of a sweep: {folder.resolve().name}"
    top = (
        f'<h1>{safe(title)}</h1>\n<p class="headline">{safe(sweep_headline(cases, state))}</p>\n'
        f"{bullets(sweep_sentences(cases, state, _planned(folder)))}"
    )
    sections = [
        ("effects", "Errors by setting", _effects(cases, state, drawing)),
        ("worst", "Worst cases", _worst_cases(cases, state, folder)),
        ("failed", "Failed cases", _failed_cases(cases)),
        ("settings", "Settings", _settings(cases, defaults, settings)),
    ]
    path = folder / "report.html"
    write_whole(path, page(title, [top, *(section(name, head, *parts) for name, head, parts in sections if parts)]))
    missing = (f"settings ({settings.reason})",) if isinstance(settings, Missing) else ()
    return WrittenReport(path, missing)


def _planned(folder: Path) -> int | Missing:
    try:
        return len(read_sweep(folder / SWEEP_FILE))
    except InputError:
        return Missing(f"without a valid {SWEEP_FILE} the number of planned cases is not known")


def _base(path: Path) -> tuple[Mapping[str, Any], StepSpace | None]:
    """Default settings, in nested tables, and the robot's space, None if its settings are not valid in this version."""
    try:
        settings = read_experiment(path, recorded=True) if path.is_file() else Experiment()
    except InputError:
        return experiment_table(Experiment()), None
    return experiment_table(Experiment(load_robot(settings.robot.name))), settings.space


SWEEP_REPORT = FolderReport(is_sweep, report_sweep)  # Reports of sweeps, for `stepgap report`


# Sentences


def sweep_headline(cases: SweepCases, state: Sequence[Quantity]) -> str:
    """Sentence on the errors before and after learning."""
    if not len(cases):
        return f"None of the {len(cases.failed)} cases in the table has a result: all failed."
    before, after = compared_errors(cases)
    if (after < before).any():
        change = f"from {_medians(before, state)} to {_medians(after, state)}"
        return f"{_cases(len(cases))}: from deployment 0 to the last one, the median RMSE changed {change}."
    last = _medians(cases.last_errors, state)
    if not last:
        return f"{_cases(len(cases))}, but no error of a last deployment is known."
    return f"{_cases(len(cases))}: the median RMSE of the last deployment is {last}."


def sweep_sentences(cases: SweepCases, state: Sequence[Quantity], planned: int | Missing) -> list[str]:
    """Sentences on finished, failed and aborted cases, and on the cases that became worse by learning."""
    done = len(cases) + len(cases.failed)
    lines = []
    if isinstance(planned, Missing):
        lines.append(f"The table has {cases.rows} rows of {_cases(done)}; {planned.reason}.")
    elif done < planned:
        lines.append(
            f"The sweep is not finished: the table has {cases.rows} rows of {done} of its {planned} cases "
            f"({100 * done / planned:.3g} %). Not all combinations of settings are there yet, so medians may change."
        )
    else:
        lines.append(f"All {planned} cases of the sweep are finished, in {cases.rows} rows of the table.")
    if cases.failed:
        lines.append(f"Without a result because they failed: {_cases(len(cases.failed))}, listed below with reasons.")
    aborted = int(cases.aborted.sum())
    if aborted:
        lines.append(
            f"In {_cases(aborted)} ({100 * aborted / len(cases):.1f} %) a deployment was aborted by a failed step, in "
            f"{cases.aborted_last.sum()} of them the last one. The error of an aborted deployment is not compared."
        )
    elif len(cases):
        lines.append("No deployment was aborted by a failed step.")
    before, after = compared_errors(cases)
    for index, quantity in enumerate(state if len(before) else ()):
        worse = int(np.count_nonzero(after[:, index] > before[:, index]))
        name = capitalised(quantity.name.replace("_", " "))
        lines.append(
            f"{name}: the RMSE of the last deployment is larger than that of deployment 0 in {worse or 'none'} of "
            f"{_cases(len(before))}."
        )
    return lines


def compared_errors(cases: SweepCases) -> tuple[Array, Array]:
    """Errors of deployment 0 and of the last one in the cases in which both can be compared; shapes (k, n)."""
    both = cases.comparable & np.isfinite(cases.first_errors).all(axis=1) & cases.redeployed
    return cases.first_errors[both], cases.last_errors[both]


def _medians(errors: Array, state: Sequence[Quantity]) -> str:
    """Medians of the errors of the state coordinates, as far as they are known."""
    parts = []
    for quantity, column in zip(state, errors.T, strict=True):
        finite = column[np.isfinite(column)]
        if len(finite):
            median = decimal(float(np.quantile(finite, 0.5, method="inverted_cdf")))
            parts.append(f"{median}{unit_suffix(quantity)} in {quantity.name}")
    return " and ".join(parts)


def _cases(number: int) -> str:
    return "1 case" if number == 1 else f"{number} cases"


# Sections


def _level_drawing(cases: SweepCases, state: Sequence[Quantity]) -> Drawing | Missing | None:
    """The figure; None if there is nothing to draw."""
    if not cases.axes or not np.isfinite(cases.last_errors).any():
        return None

    def figure() -> object:
        from stepgap.sweep.report.level_figure import level_figure

        return level_figure(cases, cases.axes[:MOST_AXES], state)

    return draw_figure(figure, "the errors by setting")


def _effects(cases: SweepCases, state: Sequence[Quantity], drawing: Drawing | Missing | None) -> list[str]:
    if not len(cases):
        return []
    if not cases.axes:
        return [paragraph("No setting on an axis has two values in the table, so there is no effect to show.")]
    parts = [picture(drawing, "levels-", _CAPTION)] if drawing else []
    hidden = [axis.name for axis in cases.axes[MOST_AXES:]]
    if hidden:
        parts.append(paragraph(f"The figure shows the first {MOST_AXES} settings, not: {', '.join(hidden)}."))
    tables = "".join(level_table(cases, axis, state) for axis in cases.axes)
    return [*parts, paragraph(LEVELS_NOTE), f'<div class="tables">{tables}</div>']


def level_table(cases: SweepCases, axis: SweepAxis, state: Sequence[Quantity]) -> str:
    """HTML table of the levels of an axis: number of cases, medians, and cases with an aborted deployment."""
    count = len(axis.levels)
    columns = {"cases": np.bincount(axis.codes, minlength=count).astype(str).tolist()}
    for index, quantity in enumerate(state):
        _, medians, _ = axis.quartiles(cases.last_errors[:, index])
        columns[f"last RMSE of {with_unit(quantity)}"] = list(map(decimal, medians))
    columns["aborted"] = np.bincount(axis.codes[cases.aborted], minlength=count).astype(str).tolist()
    if np.isfinite(cases.hops).any():
        _, medians, _ = axis.quartiles(cases.hops)
        columns["steps to band"] = ["never" if np.isinf(hops) else f"{hops:.0f}" for hops in medians]
    rows = list(zip(axis.levels, *columns.values(), strict=True))
    more = f" (the first {MOST_ROWS} of {count} levels)" if count > MOST_ROWS else ""
    return table(f"{axis.name}{more}", ["level", *columns], rows[:MOST_ROWS])


def _worst_cases(cases: SweepCases, state: Sequence[Quantity], folder: Path) -> list[str]:
    """Tables of the cases with the largest last errors, and of those whose last deployment was aborted."""
    if not len(cases):
        return []
    sizes = np.log(cases.last_errors).mean(axis=1)
    comparable = np.flatnonzero(cases.comparable)
    largest = comparable[np.argsort(-sizes[comparable], kind="stable")][:MOST_WORST]
    aborted = np.flatnonzero(cases.aborted_last)[:MOST_WORST]
    parts = []
    if len(largest):
        coordinates = "" if len(state) == 1 else ", by the geometric mean over the coordinates"
        caption = f"The {len(largest)} largest errors of the last deployment{coordinates}"
        parts.append(_case_table(caption, cases, largest, state, folder))
    if len(aborted):
        count = int(cases.aborted_last.sum())
        more = f" (the first {MOST_WORST} of {count})" if count > MOST_WORST else ""
        parts.append(_case_table(f"Cases whose last deployment was aborted{more}", cases, aborted, state, folder))
    kept = [run for row in (*largest, *aborted) if (folder / (run := f"runs/{cases.numbers[row]:08d}")).is_dir()]
    if kept:
        command = f"stepgap report {kept[0]}"
        parts.append(paragraph(f"In the folder of the sweep, this command makes the report of a case: {command}"))
    else:
        parts.append(paragraph('The runs of these cases were not kept; keep = "runs" in the sweep\'s file keeps them.'))
    return parts


def _case_table(
    caption: str, cases: SweepCases, chosen: NDArray[np.int64], state: Sequence[Quantity], folder: Path
) -> str:
    """Table of chosen cases: their settings and last errors, with links to what was kept of them."""
    names = [name for name in cases.settings if name not in cases.constants]
    rows = []
    links = {}
    for row in chosen:
        number = str(cases.numbers[row])
        settings = [_short(str(cases.settings[name][row])) for name in names]
        rows.append([number, *settings, *map(decimal, cases.last_errors[row])])
        run = f"runs/{cases.numbers[row]:08d}/"
        if (folder / run).is_dir():
            links[number] = f"{run}report.html" if (folder / run / "report.html").is_file() else run
    return table(caption, ["case", *names, *(f"last RMSE of {with_unit(quantity)}" for quantity in state)], rows, links)


def _failed_cases(cases: SweepCases) -> list[str]:
    if not cases.failed:
        return []
    rows = [[str(case.number), case.reason, *map(_short, case.settings)] for case in cases.failed[:MOST_ROWS]]
    more = len(cases.failed) - len(rows)
    caption = f"The first {len(rows)} failed cases; {more} more failed" if more else "Failed cases"
    return [table(caption, ["case", "reason", *cases.settings], rows)]


def _short(text: str) -> str:
    if not text:
        return "(empty)"
    return text if len(text) <= LONGEST_CELL else f"{text[: LONGEST_CELL - 1]}…"


def _settings(cases: SweepCases, defaults: Mapping[str, Any], settings: SettingsFile | Missing) -> list[str]:
    constants = bullets([f"{name}: {text} in all cases of the table" for name, text in cases.constants.items()])
    if isinstance(settings, Missing):
        return [constants, paragraph(f"{capitalised(settings.reason)}.")]
    changed = changed_settings(settings.table, defaults, "base of the sweep")
    note = paragraph("Settings that no axis changes are the same in all cases, as in the base experiment.")
    opened = "<details><summary>experiment.toml: all settings of the base experiment</summary>"
    return [constants, note, changed, f"{opened}<pre>{safe(settings.text)}</pre></details>"]
