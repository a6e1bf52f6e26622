"""Parts of figures that several have in common: panels along the steps, curves, scales, frames and legends."""

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from stepgap.learning.steps import Steps
from stepgap.report.drawing import GREY, MOST_VECTORS, new_figure
from stepgap.step import Array, StepStatus

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def step_panels(count: int) -> "tuple[Figure, list[Axes]]":
    """A figure with a number of panels below each other, which share their horizontal axis."""
    figure = new_figure(0.8 + 2.0 * count)
    return figure, list(figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0])


def show_steps(panels: "Sequence[Axes]", steps: Steps) -> None:
    """Sets the axis of step numbers to these steps, and marks the exploratory ones."""
    first = int(steps.number.min())
    last = int(steps.number.max())
    margin = 0.5 + 0.01 * (last - first)
    panels[0].set_xlim(first - margin, last + margin)
    for panel in panels if first < 1 else ():
        label = "exploratory steps" if panel is panels[-1] else ""
        panel.axvspan(first - margin, 0.5, color="0.93", linewidth=0, zorder=0, label=label)


def step_numbers(steps: Steps) -> Array:
    """Numbers of the steps in their deployments; shape (N,)."""
    return steps.number.astype(float)


def as_pixels(steps: Steps) -> dict[str, Any]:
    """Style of a curve over these steps: pixels if there are many."""
    return {"rasterized": len(steps) > MOST_VECTORS}


def ends_of_steps(steps: Steps, index: int) -> Array:
    """One coordinate of the next states, NaN where there was none; shape (N,)."""
    return np.where(steps.status == StepStatus.OK, steps.next_state[:, index], np.nan)


def draw_tracking(panel: "Axes", steps: Steps, index: int, name: str, style: dict[str, Any]) -> None:
    """Draws a state coordinate at the ends of steps, with a mark where there was none."""
    numbers = step_numbers(steps)
    reached = ends_of_steps(steps, index)
    panel.plot(numbers, reached, label=name, **style)
    failed = np.isnan(reached)
    if failed.any():
        mark = {"color": style["color"], "marker": "X", "linestyle": "", "markersize": 7, "clip_on": False}
        panel.plot(numbers[failed], steps.state[failed, index], label="no next state after this one", **mark)


def write_note(panel: "Axes", text: str) -> None:
    """Writes a text into an empty panel."""
    panel.set_yticks([])
    panel.text(0.5, 0.5, text, transform=panel.transAxes, ha="center", va="center", color=GREY)


def log_scale(panel: "Axes", values: Array, axis: Literal["x", "y"] = "y") -> None:
    """Sets a logarithmic axis with plain numbers for these values, if there are positive ones."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    positive = values[values > 0]
    if not len(positive):
        return
    set_scale = panel.set_xscale if axis == "x" else panel.set_yscale
    set_scale("log", nonpositive="mask")
    ticks = panel.xaxis if axis == "x" else panel.yaxis
    if positive.max() < 1e3 * positive.min():
        ticks.set_major_locator(LogLocator(subs=(1, 2, 5)))
    ticks.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ticks.set_minor_formatter(NullFormatter())


def drawn_values(panel: "Axes") -> Array:
    """Values of all curves of a panel."""
    return np.concatenate([np.asarray(line.get_ydata(), float) for line in panel.lines] or [np.zeros(0)])


def clear_frame(panel: "Axes", grid: Literal["x", "y"] | None = None) -> None:
    """Leaves out the frame above and on the right of a panel, and adds a grid across an axis behind the data."""
    panel.spines[["top", "right"]].set_visible(False)
    if grid:
        panel.grid(True, axis=grid, color="#dddddd", linewidth=0.6)
        panel.set_axisbelow(True)


def shared_legend(figure: "Figure", panels: "Iterable[Axes]") -> None:
    """Adds one legend above all panels, with each label once."""
    entries = {
        label: handle for panel in panels for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    figure.legend(list(entries.values()), list(entries), loc="outside upper center", ncols=3, frameon=False)


def finish(figure: "Figure", panels: "Sequence[Axes]", step_label: str, own_legends: bool = False) -> None:
    """Adds labels, grid, and legends outside the data: one above all panels, or one above each."""
    from matplotlib.ticker import MaxNLocator

    for panel in panels:
        clear_frame(panel, grid="y")
        panel.xaxis.set_major_locator(MaxNLocator(integer=True))
        if own_legends and panel.get_legend_handles_labels()[1]:
            panel.legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=3, frameon=False, borderaxespad=0.2)
    panels[-1].set_xlabel(step_label)
    figure.align_ylabels(panels)
    if not own_legends:
        shared_legend(figure, panels)
