"""Charts of the page: targets and apexes hop by hop, and what was learnt."""

from collections.abc import Sequence

import numpy as np
from viser import GuiApi, GuiUplotHandle, uplot

from stepgap.learning.step_log import LoggedStep
from stepgap.step import Array, Quantity
from stepgap.view.learnt import Curve

INK, TARGET, APEX, OVERLAID, BAND = "#3c3e46", "#3c3e46", "#0072b2", "#d55e00", "rgba(0,114,178,0.18)"
HEIGHT = 170


def _axes(x_label: str, y_label: str) -> tuple[uplot.Axis, uplot.Axis]:
    return (
        uplot.Axis(label=x_label, labelSize=18, size=30, stroke=INK),
        uplot.Axis(label=y_label, labelSize=18, size=58, stroke=INK),
    )


def named(quantity: Quantity, what: str = "") -> str:
    """Name and unit as axes have them."""
    return f"{what}{quantity.name}{f' [{quantity.unit}]' if quantity.unit else ''}"


class TrackingPlot:
    """Targets and apexes of one state coordinate, growing step by step."""

    def __init__(self, gui: GuiApi, quantity: Quantity, index: int):
        self._index = index
        dots = uplot.Series_Points(show=False)
        self._plot: GuiUplotHandle = gui.add_uplot(
            (np.array([0.0, 1.0]), *(np.full(2, np.nan),) * 3),
            (
                uplot.Series(label="step"),
                uplot.Series(label="target", stroke=TARGET, width=1.2, dash=(5, 3), points=dots, spanGaps=False),
                uplot.Series(label="overlaid", stroke=OVERLAID, width=1.5, dash=(2, 2), points=dots),
                uplot.Series(label="apex", stroke=APEX, width=2, points=dots),
            ),
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
            axes=_axes("step", named(quantity)),
            legend=uplot.Legend(show=True, live=False),
            height=HEIGHT,
        )

    def show(self, steps: Sequence[LoggedStep], overlaid: Sequence[LoggedStep], shown: int) -> None:
        """Draws the targets of all steps, and the apexes of the first ones."""
        if not steps:
            return
        number = np.array([float(logged.step) for logged in steps])
        target = np.array([logged.target[self._index] for logged in steps])
        other = np.full(len(steps), np.nan)
        for row, logged in enumerate(overlaid[: min(shown, len(steps))]):
            other[row] = logged.record.next_state[self._index]
        apex = np.array([logged.record.next_state[self._index] for logged in steps])
        apex[shown:] = np.nan
        self._plot.data = (number, target, other, apex)


class LearntPlot:
    """Mean and band of the error of one state coordinate along an input, with the present step's error."""

    def __init__(self, gui: GuiApi, quantity: Quantity, index: int):
        self._index = index
        none = uplot.Series_Points(show=False)
        self._plot: GuiUplotHandle = gui.add_uplot(
            (np.array([0.0, 1.0]), *(np.full(2, np.nan),) * 4),
            (
                uplot.Series(label="input"),
                uplot.Series(label="95 % of steps", stroke=BAND, width=1, points=none),
                uplot.Series(label="", stroke=BAND, width=1, points=none),
                uplot.Series(label="mean", stroke=APEX, width=2, points=none),
                uplot.Series(
                    label="this step",
                    stroke=OVERLAID,
                    width=0,
                    points=uplot.Series_Points(show=True, size=9, width=2, stroke=OVERLAID, fill=OVERLAID),
                ),
            ),
            bands=(uplot.Band(series=(1, 2), fill=BAND),),
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)},
            axes=_axes("", named(quantity, "error of ")),
            legend=uplot.Legend(show=True, live=False),
            height=HEIGHT,
        )

    def show(self, curve: Curve, label: str, error: Array) -> None:
        """Draws a curve and the error that the present step had; shape (n,), NaN where unknown."""
        mean, margin = curve.mean[:, self._index], curve.margin[:, self._index]
        here = np.full(len(mean), np.nan)
        here[curve.here] = error[self._index]
        self._plot.data = (curve.inputs, mean + margin, mean - margin, mean, here)
        self._plot.axes = (uplot.Axis(label=label, labelSize=18, size=30, stroke=INK), self._plot.axes[1])  # type: ignore[index]

    def clear(self) -> None:
        """Draws nothing: nothing was learnt."""
        self._plot.data = (np.array([0.0, 1.0]), *(np.full(2, np.nan),) * 4)
