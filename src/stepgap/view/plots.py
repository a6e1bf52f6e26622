"""Charts of the page: targets and measured states step by step.

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

INK = "#3c3e46"
TRANSPARENT = "rgba(0,0,0,0)"
HEIGHT = 160  # Height of a chart [pixels]

NO_DOTS = uplot.Series_Points(show=False)


def add_legend(gui: GuiApi, entries: Sequence[tuple[str, str, str]]) -> None:
    """Adds a legend of marks: mark, colour, meaning."""
    parts = (f'<span style="color:{colour}">{mark}</span>&nbsp;{meaning}' for mark, colour, meaning in entries)
    gui.add_html(f'<div style="font-size:0.8em;padding:0.2em 1em">{"&emsp;".join(parts)}</div>')


def _line(colour: str, width: float, dash: tuple[float, ...] = ()) -> uplot.Series:
    return uplot.Series(stroke=colour, width=width, dash=dash, points=NO_DOTS, auto=False)


def _axis(label: str, size: int) -> uplot.Axis:
    font = "12px sans-serif"
    return uplot.Axis(label=label, labelSize=16, size=size, labelFont=font, font=font, stroke=INK)


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
        span = uplot.Series(stroke=TRANSPARENT, width=0, points=NO_DOTS)
        lines = _line(INK, 1.2, (5, 3)), _line(VERMILLION, 1.5, (2, 2)), _line(BLUE, 2)
        self._chart: GuiUplotHandle = gui.add_uplot(
            _blank(5),
            (uplot.Series(), span, *lines),
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
            axes=(_axis("step", 30), _axis(with_unit(quantity), 54)),
            legend=uplot.Legend(show=False),
            height=HEIGHT,
            padding=(8, 8, 0, 0),
        )

    def show(self, steps: Sequence[LoggedStep], overlaid: Sequence[LoggedStep], count: int) -> None:
        """Draws the targets of all steps, and the next states of the first `count` steps."""
        if not steps:
            self._chart.data = _blank(5)
            return
        number = np.array([float(logged.step) for logged in steps])
        target = np.array([logged.target[self._index] for logged in steps])
        found = self._next_states(steps, len(steps))
        other = self._next_states(overlaid, len(steps))
        span = _span(target, found, other)
        found[count:], other[count:] = np.nan, np.nan
        self._chart.data = (number, span, target, other, found)

    def _next_states(self, steps: Sequence[LoggedStep], count: int) -> Array:
        """Next states of the first steps, NaN where there are fewer; shape (count,)."""
        values = np.full(count, np.nan)
        known = [logged.record.next_state[self._index] for logged in steps[:count]]
        values[: len(known)] = known
        return values
