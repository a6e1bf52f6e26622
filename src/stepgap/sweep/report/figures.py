"""Figures of a sweep: errors, aborted deployments and steps to the band by the levels of each axis; sensitivity."""

from collections.abc import Callable, Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from stepgap.report.drawing import BLACK, BLUE, GREY, LIGHT, SKY, VERMILLION, WIDTH, axis_label, log_scale, plain
from stepgap.step import Array, Quantity
from stepgap.sweep.report.cases import SweepAxis, SweepCases
from stepgap.sweep.report.levels import Estimates, level_means, quartiles, shares
from stepgap.sweep.report.sentences import CHANCE, percent
from stepgap.sweep.report.variance_shares import VarianceShares

COLUMNS: Final = 3
"""Number of panels side by side."""

MOST_NAMES: Final = 12
"""Number of levels up to which each is labelled; more of them are sorted by their value."""

MOST_SORTED: Final = 50
"""Largest number of sorted levels that are drawn."""

MOST_POINTS: Final = 150
"""Largest number of single cases drawn in a panel."""

_FIRST: Final = {"color": VERMILLION, "marker": "s", "markersize": 3.5, "label": "deployment 0, before learning"}
_LAST: Final = {"color": BLUE, "marker": "o", "markersize": 4, "label": "last deployment"}
_BEYOND: Final = 4
"""Largest ratio of an end of an interval, or of a point, to the nearest mean, within the limits."""


def main_effects_figure(
    cases: SweepCases, axes: Sequence[SweepAxis], index: int, quantity: Quantity, rng: np.random.Generator
) -> Figure:
    """Errors of one state coordinate by the levels of each axis: geometric means with 95 % intervals.

    Args:
        cases: The cases.
        axes: Axes to show.
        index: Index of the state coordinate.
        quantity: The state coordinate.
        rng: Chooses the single cases that are drawn.
    """
    figure, panels = _panels(len(axes))
    series = [(cases.first_errors[:, index], _FIRST)] if cases.redeployed.any() else []
    series.append((cases.last_errors[:, index], _LAST))
    drawn = rng.permutation(len(cases))[:MOST_POINTS]
    points = cases.last_errors[drawn, index] if any(axis.points is not None for axis in axes) else np.zeros(0)
    found: list[Estimates] = []
    for panel, axis in zip(panels, axes, strict=True):
        each = [level_means(axis, errors) for errors, _ in series]
        positions = _level_positions(panel, axis, each[-1].values)
        if axis.points is not None and axis.values is not None and np.isfinite(axis.values).all():
            look: dict[str, Any] = {"color": LIGHT, "marker": ".", "markersize": 2.5, "linestyle": "", "zorder": 1}
            panel.plot(axis.values[drawn], points, **look, label="single cases, last deployment")
        for estimates, (_, look) in zip(each, series, strict=True):
            _draw(panel, axis, positions, estimates, look)
        found += each
    _limit(panels[0], found, points)
    _finish(figure, panels, f"RMSE of {axis_label(quantity, capital=False)}")
    return figure


def aborted_figure(cases: SweepCases, axes: Sequence[SweepAxis]) -> Figure:
    """Share of the cases with an aborted deployment by the levels of each axis, with 95 % intervals."""
    figure, panels = _panels(len(axes))
    for panel, axis in zip(panels, axes, strict=True):
        estimates = shares(cases.aborted, axis.codes, len(axis.levels))
        _draw(panel, axis, _level_positions(panel, axis, estimates.values), estimates, {"color": BLACK, "marker": "o"})
    panels[0].set_ylim(bottom=0)
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g}"))
    _finish(figure, panels, "Cases with an aborted deployment [%]")
    return figure


def hops_figure(cases: SweepCases, axes: Sequence[SweepAxis]) -> Figure:
    """Steps to the band by the levels of each axis: medians, with bars between the quartiles."""
    figure, panels = _panels(len(axes))
    never = 1.15 * float(np.max(cases.hops, where=np.isfinite(cases.hops), initial=0))
    for panel, axis in zip(panels, axes, strict=True):
        lower, middle, upper = quartiles(np.minimum(cases.hops, never), axis.codes, len(axis.levels))
        estimates = Estimates(np.bincount(axis.codes, minlength=len(axis.levels)), middle, lower, upper)
        panel.axhline(never, color=GREY, linestyle=(0, (1, 2)), linewidth=0.8)
        positions = _level_positions(panel, axis, middle)
        _draw(panel, axis, positions, estimates, {"color": BLUE, "marker": "D", "markersize": 3.5})
    ticks = [tick for tick in MaxNLocator(5).tick_values(0, never / 1.15) if 0 <= tick < 0.95 * never]
    panels[0].set_ylim(0, 1.05 * never)
    panels[0].yaxis.set_major_locator(FixedLocator([*ticks, never]))
    panels[0].yaxis.set_major_formatter(FuncFormatter(lambda value, _: "never" if value >= never else f"{value:g}"))
    _finish(figure, panels, "Steps to the band")
    return figure


def sensitivity_figure(found: VarianceShares, state: Sequence[Quantity]) -> Figure:
    """Shares of the variance that axes explain; light where they may be by chance."""
    names = short_names([share.name for share in found.axes])
    labels = [*map(plain, names.values()), "everything else"]
    figure = Figure(figsize=(WIDTH, 0.7 + 0.19 * len(labels)), layout="constrained")
    panels = list(figure.subplots(1, len(state), sharey=True, squeeze=False)[0])
    for index, (panel, quantity) in enumerate(zip(panels, state, strict=True)):
        values = 100 * np.array([*(share.values[index] for share in found.axes), found.remainder[index]])
        colours = [BLUE if share.chance[index] < CHANCE else SKY for share in found.axes]
        panel.barh(range(len(labels)), values, height=0.7, color=[*colours, LIGHT])
        for row, value in enumerate(values):
            panel.annotate(percent(value), (max(value, 0), row), (3, 0), textcoords="offset points", va="center")
        panel.set_xlabel(f"Share of the variance of the logarithm\nof the last {plain(quantity.name)} error [%]")
        panel.set_xlim(min(0.0, 1.05 * values.min()), 1.22 * max(values.max(), 1.0))
        panel.spines[["top", "right"]].set_visible(False)
        panel.axvline(0, color=BLACK, linewidth=0.7)
    panels[0].set_yticks(range(len(labels)), labels)
    panels[0].invert_yaxis()
    return figure


def short_names(names: Sequence[str]) -> dict[str, str]:
    """Names of settings without their table, where they stay different."""
    lasts = [name.rpartition(".")[2] for name in names]
    return {name: last if lasts.count(last) == 1 else name for name, last in zip(names, lasts, strict=True)}


def _panels(count: int) -> tuple[Figure, list[Axes]]:
    """A figure with panels in rows, which have the same vertical axis."""
    rows = -(-count // COLUMNS)
    figure = Figure(figsize=(WIDTH, 0.5 + 1.75 * rows), layout="constrained")
    panels = list(figure.subplots(rows, COLUMNS, sharey=True, squeeze=False).ravel())
    for panel in panels[count:]:
        panel.set_visible(False)
    return figure, panels[:count]


def _level_positions(panel: Axes, axis: SweepAxis, ranking: Array) -> Array:
    """Prepares the horizontal axis of a panel, and returns the position of each level; shape (L,).

    Args:
        panel: The panel.
        axis: The axis.
        ranking: Values by which many names are sorted; shape (L,).
    """
    panel.set_xlabel(plain(axis.name))
    count = len(axis.levels)
    if axis.values is not None and np.isfinite(axis.values).all():
        order = np.lexsort((axis.values, axis.codes))
        counts = np.bincount(axis.codes, minlength=count)
        positions = axis.values[order][np.cumsum(counts) - counts + counts // 2]
        _number_axis(panel, axis, positions)
        return positions
    if count > MOST_NAMES:
        of_them = f"{MOST_SORTED} of " if count > MOST_SORTED else ""
        panel.set_xlabel(f"{plain(axis.name)}: {of_them}{count} levels, sorted")
        panel.xaxis.set_major_locator(NullLocator())
        return np.argsort(np.argsort(ranking)).astype(float)
    positions, labels = np.arange(count, dtype=float), [plain(level) for level in axis.levels]
    long = sum(map(len, labels)) > 26
    look = {"rotation": 30, "ha": "right", "rotation_mode": "anchor"} if long else {}
    panel.set_xticks(positions, labels, **look)
    panel.set_xlim(-0.5, count - 0.5)
    return positions


def _number_axis(panel: Axes, axis: SweepAxis, positions: Array) -> None:
    """Scale and ticks of a numeric setting: logarithmic where its values are spread more evenly so."""
    values = np.unique(np.asarray(axis.values))
    logarithmic = bool(values[0] > 0) and _unevenness(np.log(values)) + 0.1 < _unevenness(values)
    if logarithmic:
        panel.set_xscale("log")
        panel.xaxis.set_major_locator(LogLocator(numticks=6))
        panel.xaxis.set_minor_formatter(NullFormatter())
    else:
        panel.xaxis.set_major_locator(MaxNLocator(5))
    if axis.points is None and len(positions) <= 6:
        panel.set_xticks(positions, axis.levels)
        panel.xaxis.set_minor_locator(NullLocator())
    if axis.points is None:
        panel.margins(x=0.12)


def _unevenness(values: Array) -> float:
    """Distance of the median from the middle of the range, as a fraction of the range."""
    return abs(float((np.median(values) - values[0]) / (values[-1] - values[0])) - 0.5)


def _draw(panel: Axes, axis: SweepAxis, positions: Array, estimates: Estimates, look: dict[str, Any]) -> None:
    """Draws estimates with their intervals; the levels of a number are connected."""
    many = axis.values is None and len(axis.levels) > MOST_NAMES
    bars = [estimates.values - estimates.lower, estimates.upper - estimates.values]
    style = {"linestyle": "-" if axis.values is not None else "", "linewidth": 0.9, "elinewidth": 0.9, "zorder": 3}
    if many:
        look = {**look, "markersize": 2}
    order = np.argsort(positions)
    heights = np.maximum(np.nan_to_num(bars, nan=0.0), 0)
    if many:
        order = order[np.linspace(0, len(order) - 1, min(len(order), MOST_SORTED)).round().astype(int)]
    known = order[np.isfinite(estimates.values[order])]
    panel.errorbar(
        positions[known], estimates.values[known], heights[:, known], capsize=0 if many else 2, **{**style, **look}
    )


def _limit(panel: Axes, found: Sequence[Estimates], points: Array) -> None:
    """Sets a logarithmic vertical axis, on which very wide intervals and points far outside are cut off."""
    means, lower, upper = (np.concatenate([getattr(each, name) for each in found]) for name in Estimates._fields[1:])
    known = np.isfinite(means)
    if not known.any():
        return
    smallest, largest = means[known].min(), means[known].max()
    log_scale(panel, means[known])
    least = max(np.nanmin([*lower, *points, smallest]), smallest / _BEYOND)
    panel.set_ylim(least / 1.15, 1.15 * min(np.nanmax([*upper, *points, largest]), largest * _BEYOND))


def _finish(figure: Figure, panels: Sequence[Axes], label: str) -> None:
    """Adds the label of the vertical axis, a grid, and a legend above all panels."""
    for row, panel in enumerate(panels):
        panel.grid(True, axis="y", color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)
        panel.spines[["top", "right"]].set_visible(False)
        if row % COLUMNS == 0:
            panel.set_ylabel(label if len(label) < 28 else label.replace(" of ", " of\n", 1))
    found = _handles(panels)
    if found:
        figure.legend(list(found.values()), list(found), loc="outside upper center", ncols=4, frameon=False)


def _handles(panels: Sequence[Axes]) -> dict[str, Any]:
    get: Callable[[Axes], Any] = Axes.get_legend_handles_labels
    return {label: handle for panel in panels for handle, label in zip(*get(panel), strict=True)}
