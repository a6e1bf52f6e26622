"""The report of a sweep: figures and the page `report.html`."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from stepgap.base.files import write_whole
from stepgap.experiment.displays import WrittenReport
from stepgap.experiment.settings import SettingsFile, read_settings_file
from stepgap.records.missing import Missing
from stepgap.records.text import capitalised
from stepgap.report.drawing import Drawing, draw_figure, has_figures, write_figures
from stepgap.report.html import absence, bullets, page, paragraph, picture, safe, section
from stepgap.report.settings_table import changed_settings
from stepgap.step import Quantity
from stepgap.sweep.report.case_tables import failed_cases, worst_cases
from stepgap.sweep.report.cases import SweepAxis, SweepCases, sweep_cases
from stepgap.sweep.report.level_tables import level_table
from stepgap.sweep.report.sentences import share_notes, sweep_headline, sweep_sentences
from stepgap.sweep.report.variance_shares import VarianceShares, variance_shares
from stepgap.sweep.results_table import RESULTS, read_results

SECTIONS: Final = {
    "effects": "Effects of the settings",
    "aborted": "Aborted deployments and steps to the band",
    "sensitivity": "Which settings matter",
    "levels": "Numbers by level",
    "worst": "Worst cases",
    "failed": "Failed cases",
    "settings": "Settings",
}
"""Sections of the page, with their titles; those without content are left out."""

MOST_AXES: Final = 12
"""Number of axes, those with the largest shares of the variance, whose levels are drawn."""

INTERVALS: Final = (
    "Intervals are 95 % intervals and treat the cases as independent, although cases share twins and seeds. The "
    "geometric mean is the exponential of the mean logarithm: one case with a large error does not dominate it."
)
EFFECTS_CAPTION: Final = (
    "RMSE of {name} by the value of each setting: geometric mean of the cases with this value, whatever their other "
    "settings, of which that deployment was not aborted, with a 95 % interval. All panels have the same vertical axis, "
    "so a steeper curve is a larger effect."
)
POINTS_CAPTION: Final = (
    " A setting with many values is divided into ranges with equally many cases; grey points are single cases. Cases "
    "in which all settings of this kind are equal count as one in the interval."
)
LEVELS_NOTE: Final = (
    "Errors are geometric means of the last deployments, with 95 % intervals. A pair is two cases of which all other "
    "settings and the seed are equal, one at the first level and one at this level; the ratio is the geometric mean of "
    "the ratios of all pairs. What both cases of a pair share cancels in it, so its interval is narrower."
)
ABORTED_CAPTION: Final = (
    "Share of the cases in which any deployment was aborted by a failed step, with 95 % interval (Wilson)."
)
HOPS_CAPTION: Final = (
    "Number of steps, over all deployments, until the error stays in {}'s band: median, with a bar between the "
    "quartiles. A case that did not reach the band, or whose last deployment was aborted, counts as never."
)
SENSITIVITY_CAPTION: Final = (
    "Share of the variance of the logarithm of the last RMSE that the effects of each setting explain."
)


@dataclass(frozen=True, eq=False)
class SweepContext:
    """Information on a sweep that is not in its table; by default there is none.

    Attributes:
        planned: Number of cases of the whole sweep.
        defaults: Default value of every setting, in nested tables like those of `experiment.toml`.
        state: Names and units of the state coordinates; empty if the units are not known.
        published: Source of the published result whose band is meant; empty if there is none.
    """

    planned: int | Missing = Missing("the number of planned cases is not known")
    defaults: Mapping[str, Any] | Missing = Missing("the default settings were not given")
    state: tuple[Quantity, ...] = ()
    published: str = ""


@dataclass(frozen=True, eq=False)
class _Sweep:
    """What the page shows: cases, axes by their effect, and sensitivity."""

    folder: Path
    cases: SweepCases
    state: Sequence[Quantity]
    axes: Sequence[SweepAxis]
    shares: VarianceShares | Missing


def write_sweep_report(folder: Path, context: SweepContext | None = None, figures: bool = False) -> WrittenReport:
    """Writes `report.html` of a sweep, finished or not, and on demand `figures/*.png` and `figures/*.pdf`.

    Args:
        folder: Folder of the sweep, with `results.csv`.
        context: Information that is not in the table.
        figures: As of `write_report`.

    Raises:
        ValueError: The table or the settings are not valid.
        OSError: A file cannot be read or written.
    """
    context = context or SweepContext()
    sweep = _read(folder, context.state)
    settings = read_settings_file(folder / "experiment.toml")
    drawings = _drawings(sweep)
    if figures or has_figures(folder):
        write_figures(folder, {_figure_name(name, sweep): drawing for name, drawing in drawings.items()})
    path = folder / "report.html"
    write_whole(path, _html(sweep, drawings, context, settings))
    missing = (f"settings ({settings.reason})",) if isinstance(settings, Missing) else ()
    return WrittenReport(path, missing)


def _read(folder: Path, state: Sequence[Quantity]) -> _Sweep:
    path = folder / RESULTS
    try:
        cases = sweep_cases(read_results(path))
        known = {quantity.name: quantity for quantity in state}
        quantities = [known.get(name) or Quantity(name, "", -1, 1) for name in cases.state_names]
    except ValueError as error:
        raise ValueError(str(error) if str(path) in str(error) else f"{path}: {error}") from None
    found = variance_shares(cases)
    axes = cases.axes
    if not isinstance(found, Missing):
        order = {share.name: rank for rank, share in enumerate(found.axes)}
        axes = tuple(sorted(axes, key=lambda axis: order.get(axis.name, len(order))))
    return _Sweep(folder, cases, quantities, axes, found)


def _drawings(sweep: _Sweep) -> dict[str, Drawing | Missing]:
    """All figures by name; those without content are left out."""
    cases, axes = sweep.cases, sweep.axes[:MOST_AXES]
    makers: dict[str, tuple[Callable[[Any], object], str]] = {}
    if axes:
        for index, quantity in enumerate(sweep.state):
            if np.isfinite(cases.last_errors[:, index]).any():
                makers[f"effects_{index}"] = (
                    lambda figures, index=index, quantity=quantity: figures.main_effects_figure(
                        cases, axes, index, quantity, np.random.default_rng(0)
                    ),
                    f"the effects on {quantity.name}",
                )
        if cases.aborted.any():
            makers["aborted"] = (lambda figures: figures.aborted_figure(cases, axes), "the aborted deployments")
        if np.isfinite(cases.hops).any():
            makers["hops"] = (lambda figures: figures.hops_figure(cases, axes), "the steps to the band")
    if not isinstance(found := sweep.shares, Missing):
        makers["sensitivity"] = (lambda figures: figures.sensitivity_figure(found, sweep.state), "the sensitivity")
    return {name: _drawn(make, subject) for name, (make, subject) in makers.items()}


def _drawn(make: Callable[[Any], object], subject: str) -> Drawing | Missing:
    def figure() -> object:
        from stepgap.sweep.report import figures

        return make(figures)

    return draw_figure(figure, subject)


def _figure_name(name: str, sweep: _Sweep) -> str:
    """Name of the file of a figure."""
    index = name.removeprefix("effects_")
    return name if index == name else f"effects_{sweep.cases.state_names[int(index)]}"


def _html(
    sweep: _Sweep, drawings: Mapping[str, Drawing | Missing], context: SweepContext, settings: SettingsFile | Missing
) -> str:
    cases = sweep.cases
    title = f"StepGap report of a sweep: {sweep.folder.resolve().name}"
    parts = {
        "effects": _effects(sweep, drawings) if len(cases) else [],
        "aborted": _aborted(cases, drawings, context.published) if len(cases) else [],
        "sensitivity": _sensitivity(sweep, drawings) if len(cases) else [],
        "levels": _levels(sweep),
        "worst": [worst_cases(cases, sweep.folder, sweep.state)] if len(cases) else [],
        "failed": [failed_cases(cases)] if cases.failed else [],
        "settings": _settings(cases, context.defaults, settings),
    }
    shown = {name: found for name, found in parts.items() if found}
    links = "".join(f'<a href="#{name}">{SECTIONS[name]}</a>' for name in shown)
    top = (
        f'<h1>{safe(title)}</h1>\n<nav>{links}</nav>\n<p class="headline">{safe(sweep_headline(cases, sweep.state))}'
        f"</p>\n{bullets(sweep_sentences(cases, sweep.state, context.planned, sweep.shares))}"
    )
    return page(title, [top, *(section(name, SECTIONS[name], *found) for name, found in shown.items())])


def _effects(sweep: _Sweep, drawings: Mapping[str, Drawing | Missing]) -> list[str]:
    if not sweep.axes:
        return [paragraph("No setting on an axis has two values in the table, so there is no effect to show.")]
    divided = POINTS_CAPTION if any(axis.points is not None for axis in sweep.axes[:MOST_AXES]) else ""
    pictures = [
        picture(drawings[name], f"{name}-", EFFECTS_CAPTION.format(name=quantity.name) + divided)
        for index, quantity in enumerate(sweep.state)
        if (name := f"effects_{index}") in drawings
    ]
    hidden = [axis.name for axis in sweep.axes[MOST_AXES:]]
    more = f"The figures show the {MOST_AXES} settings with the largest effects, not: {', '.join(hidden)}. "
    return [*pictures, paragraph(more * bool(hidden) + INTERVALS)]


def _aborted(cases: SweepCases, drawings: Mapping[str, Drawing | Missing], published: str) -> list[str]:
    if not cases.axes:
        return []
    parts = [("aborted", ABORTED_CAPTION, "No deployment of any case was aborted.")]
    if published or "hops" in drawings:
        source = published or "the published result"
        otherwise = f"No case is known to have reached {source}'s band."
        parts.append(("hops", HOPS_CAPTION.format(source), otherwise))
    return [
        picture(drawings[name], f"{name}-", caption) if name in drawings else paragraph(otherwise)
        for name, caption, otherwise in parts
    ]


def _sensitivity(sweep: _Sweep, drawings: Mapping[str, Drawing | Missing]) -> list[str]:
    if isinstance(sweep.shares, Missing):
        return [absence("sensitivity", sweep.shares)]
    notes = bullets(share_notes(sweep.cases, sweep.shares))
    return [picture(drawings["sensitivity"], "sensitivity-", SENSITIVITY_CAPTION), notes]


def _levels(sweep: _Sweep) -> list[str]:
    tables = [level_table(sweep.cases, axis, sweep.state) for axis in sweep.axes]
    return [paragraph(LEVELS_NOTE), *tables] if tables else []


def _settings(cases: SweepCases, defaults: Mapping[str, Any] | Missing, settings: SettingsFile | Missing) -> list[str]:
    constants = [f"{name}: {text} in all cases of the table" for name, text in cases.constants.items()]
    if isinstance(settings, Missing):
        return [bullets(constants), paragraph(f"{capitalised(settings.reason)}.")]
    if isinstance(defaults, Missing):
        changed = absence("comparison with the default settings", defaults)
    else:
        changed = changed_settings(settings.table, defaults, "base of the sweep")
    note = paragraph("Settings that no axis changes are the same in all cases, as in the base experiment.")
    opened = "<details><summary>experiment.toml: all settings of the base experiment</summary>"
    return [bullets(constants), note, changed, f"{opened}<pre>{safe(settings.text)}</pre></details>"]
