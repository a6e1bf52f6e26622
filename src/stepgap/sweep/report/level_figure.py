"""The figure of a sweep: medians of the errors by the levels of each axis."""

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stepgap.report.drawing import BLUE, VERMILLION, axis_label, new_figure, plain
from stepgap.report.plots import clear_frame, log_scale, shared_legend
from stepgap.step import Array, Quantity
from stepgap.sweep.report.cases import SweepAxis, SweepCases

MOST_LEVELS_DRAWN: Final = 20  # Number of levels of an axis that are drawn

_ROW: Final = 0.16  # Height of a level [inches]
_HEAD: Final = 0.22  # Height of the space around an axis [inches]


def level_figure(cases: SweepCases, axes: Sequence[SweepAxis], state: Sequence[Quantity]) -> Figure:
    """Medians of the errors by the levels of each axis, with bars between the quartiles: a column a coordinate."""
    heights = [_HEAD + _ROW * min(len(axis.levels), MOST_LEVELS_DRAWN) for axis in axes]
    figure = new_figure(0.8 + sum(heights))
    panels = figure.subplots(
        len(axes), len(state), squeeze=False, sharex="col", sharey="row", gridspec_kw={"height_ratios": heights}
    )
    series: list[tuple[Array, dict[str, Any]]] = []
    if cases.redeployed.any():
        look = {"color": VERMILLION, "marker": "s", "markersize": 3, "label": "deployment 0, before learning"}
        series.append((cases.first_errors, look))
    series.append((cases.last_errors, {"color": BLUE, "marker": "o", "markersize": 3.5, "label": "last deployment"}))
    for axis, row in zip(axes, panels, strict=True):
        for index, panel in enumerate(row):
            for errors, look in series:
                _draw(panel, axis.quartiles(errors[:, index])[:, :MOST_LEVELS_DRAWN], look)
        _name_levels(row[0], axis)
    for index, quantity in enumerate(state):
        panels[-1, index].set_xlabel(f"RMSE of {axis_label(quantity, capital=False)}")
        log_scale(panels[-1, index], np.concatenate([errors[:, index] for errors, _ in series]), "x")
    shared_legend(figure, panels[0, :1])
    return figure


def _draw(panel: Axes, quartiles: Array, look: dict[str, Any]) -> None:
    lower, middle, upper = quartiles
    rows = np.arange(len(middle))
    bars = [middle - lower, upper - middle]
    panel.errorbar(middle, rows, xerr=bars, linestyle="", elinewidth=0.9, **look)
    clear_frame(panel, grid="x")


def _name_levels(panel: Axes, axis: SweepAxis) -> None:
    """Labels the levels of an axis, the first one at the top; the panels of a row share them."""
    shown = axis.levels[:MOST_LEVELS_DRAWN]
    left_out = len(axis.levels) - len(shown)
    panel.set_yticks(range(len(shown)), [plain(level) for level in shown])
    panel.set_ylim(len(shown) - 0.5, -0.5)
    more = f"\n(without {left_out} levels)" if left_out else ""
    panel.set_ylabel(plain(axis.name) + more, rotation=0, ha="right", va="center")
