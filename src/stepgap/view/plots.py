"""Charts of the page: targets and measured states step by step, and the learned error.

A series without a number at its left end would disturb the automatic range of its chart. Therefore an extra invisible
series spans the range.
"""

from collections.abc import Sequence

import numpy as np
from viser import GuiApi, GuiUplotHandle, uplot

from stepgap.learning.steps import LoggedStep
from stepgap.records.text import with_unit
from stepgap.report.drawing import BLUE, VERMILLION
from stepgap.step import Array, Quantity
from stepgap.view.learned import Curve

INK, BAND, TRANSPARENT = "#3c3e46", "rgba(0,114,178,0.2)", "rgba(0,0,0,0)"
HEIGHT = 160
"""Height of a chart [pixels]."""

NO_DOTS = uplot.Series_Points(show=False)


def named(quantity: Quantity, prefix: str = "") -> str:
    """Axis label with name and unit."""
    return f"{prefix}{with_unit(quantity)}"


def add_legend(gui: GuiApi, entries: Sequence[tuple[str, str, str]]) -> None:
    """Adds a legend of marks: mark, colour, meaning."""
    parts = (f'<span style="color:{colour}">{mark}</span>&nbsp;{meaning}' for mark, colour, meaning in entries)
    gui.add_html(f'<div style="font-size:0.8em;padding:0.2em 1em">{"&emsp;".join(parts)}</div>')


def _line(colour: str, width: float, dash: tuple[float, ...] = ()) -> uplot.Series:
    return uplot.Series(stroke=colour, width=width, dash=dash, points=NO_DOTS, auto=False)


def _add_chart(
    gui: GuiApi, series: Sequence[uplot.Series], x_label: str, y_label: str, bands: tuple[uplot.Band, ...] = ()
) -> GuiUplotHandle:
    span = uplot.Series(stroke=TRANSPARENT, width=0, points=NO_DOTS)
    return gui.add_uplot(
        _blank(2 + len(series)),
        (uplot.Series(), span, *series),
        bands=bands,
        scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
        axes=_axes(x_label, y_label),
        legend=uplot.Legend(show=False),
        height=HEIGHT,
        padding=(8, 8, 0, 0),
    )


def _axes(x_label: str, y_label: str) -> tuple[uplot.Axis, uplot.Axis]:
    font = "12px sans-serif"
    return (
        uplot.Axis(label=x_label, labelSize=16, size=30, labelFont=font, font=font, stroke=INK),
        uplot.Axis(label=y_label, labelSize=16, size=54, labelFont=font, font=font, stroke=INK),
    )


def _blank(columns: int) -> tuple[Array, ...]:
    return (np.array([0.0, 1.0]), np.array([0.0, 1.0]), *(np.full(2, np.nan) for _ in range(columns - 2)))


def _span(*columns: Array) -> Array:
    """Series of the length of a column that contains the smallest and the largest of all numbers."""
    numbers = np.concatenate([column[np.isfinite(column)] for column in columns])
    span = np.full(len(columns[0]), numbers.min())
    span[-1] = numbers.max()
    return span


class TrackingPlot:
    """Chart of targets and next states of one coordinate, step by step."""

    def __init__(self, gui: GuiApi, quantity: Quantity, index: int):
        self._index = index
        series = _line(INK, 1.2, (5, 3)), _line(VERMILLION, 1.5, (2, 2)), _line(BLUE, 2)
        self._chart = _add_chart(gui, series, "step", named(quantity))

    def show(self, steps: Sequence[LoggedStep], overlaid: Sequence[LoggedStep], count: int) -> None:
        """Draws the targets of all steps, and the next states of the first `count` steps."""
        if not steps:
            self._chart.data = _blank(5)
            return
        number = np.array([float(logged.step) for logged in steps])
        target = np.array([logged.target[self._index] for logged in steps])
        found, other = self._next_states(steps, len(steps)), self._next_states(overlaid, len(steps))
        span = _span(target, found, other)
        found[count:], other[count:] = np.nan, np.nan
        self._chart.data = (number, span, target, other, found)

    def _next_states(self, steps: Sequence[LoggedStep], count: int) -> Array:
        """Next states of the first steps, NaN where there are fewer; shape (count,)."""
        values = np.full(count, np.nan)
        known = [logged.record.next_state[self._index] for logged in steps[:count]]
        values[: len(known)] = known
        return values


class LearnedPlot:
    """Chart of mean and band of the error of one state coordinate along an input, with the error of the step."""

    def __init__(self, gui: GuiApi, quantity: Quantity, index: int):
        self._index, self._y_label, self._x_label = index, named(quantity, "error of "), ""
        dot = uplot.Series_Points(show=True, size=9, width=2, stroke=VERMILLION, fill=VERMILLION)
        here = uplot.Series(stroke=VERMILLION, width=0, points=dot, auto=False)
        series = _line(BAND, 1), _line(BAND, 1), _line(BLUE, 2), here
        self._chart = _add_chart(gui, series, " ", self._y_label, bands=(uplot.Band(series=(2, 3), fill=BAND),))

    def show(self, curve: Curve, label: str, error: Array) -> None:
        """Draws a curve along the input with this label, and the error of the step; shape (n,), NaN where unknown."""
        mean, margin = curve.mean[:, self._index], curve.margin[:, self._index]
        here = np.full(len(mean), np.nan)
        here[curve.here] = error[self._index]
        upper, lower = mean + margin, mean - margin
        self._chart.data = (curve.inputs, _span(upper, lower, here), upper, lower, mean, here)
        if label != self._x_label:
            self._chart.axes, self._x_label = _axes(label, self._y_label), label

    def clear(self) -> None:
        """Clears the chart, because nothing was learned."""
        self._chart.data = _blank(6)
