"""The figure of errors against state and command, which shows where a map or a controller is wrong."""

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from stepgap.experiment.run import Run
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import BLUE, GREY, MOST_VECTORS, VERMILLION, axis_label, new_figure, unit_label
from stepgap.report.figures import RunFigure

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

MOST_INPUTS: Final = 6
"""Largest number of coordinates against which errors are drawn, so that the panels can be read."""


def state_error_figure(run: Run) -> "Figure":
    """Tracking and prediction errors of the last deployment against the coordinates of state and command."""
    from matplotlib.ticker import MaxNLocator

    steps = run.steps.of_iteration(run.shown_iterations[-1]).tracking().completed()
    inputs = [*run.space.state, *run.space.command][:MOST_INPUTS]
    values = np.hstack([steps.state, steps.requested])
    rows = len(run.space.state)
    figure = new_figure(0.7 + 1.7 * rows)
    panels = figure.subplots(rows, len(inputs), squeeze=False, sharex="col", sharey="row")
    dots: dict[str, Any] = {
        "linestyle": "",
        "markersize": 3,
        "markerfacecolor": "none",
        "markeredgewidth": 0.5,
        "rasterized": len(steps) > MOST_VECTORS,
    }
    kinds = {
        "tracking error, next state − target": (steps.next_state - steps.target, VERMILLION, "o"),
        "error of the prediction, next state − predicted": (steps.next_state - steps.predicted, BLUE, "."),
    }
    for row, quantity in enumerate(run.space.state):
        for column, panel in enumerate(panels[row]):
            panel.axhline(0, color=GREY, linewidth=0.8)
            for label, (error, colour, marker) in kinds.items():
                panel.plot(values[:, column], error[:, row], marker, color=colour, label=label, **dots)
            panel.spines[["top", "right"]].set_visible(False)
            panel.xaxis.set_major_locator(MaxNLocator(4))
        panels[row][0].set_ylabel(f"Error of\n{axis_label(quantity, capital=False)}")
    for panel, quantity in zip(panels[-1], inputs, strict=True):
        panel.set_xlabel(f"{axis_label(quantity)}" if len(inputs) < 5 else f"{quantity.name}\n{unit_label(quantity)}")
    figure.align_ylabels(panels[:, 0])
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)
    return figure


def _caption(analysis: Analysis) -> str:
    return (
        f"Errors in deployment {analysis.run.shown_iterations[-1]} against the state at the start of each step and the "
        "command. Errors that depend on a coordinate show what the map, or the controller, does not take into account. "
        "Where the map predicted that the target would be reached, the two errors are equal: dots are in circles."
    )


STATE_ERRORS = RunFigure(
    "state_errors",
    "figures",
    4,
    "the errors against state and command",
    _caption,
    lambda analysis: state_error_figure(analysis.run),
)
