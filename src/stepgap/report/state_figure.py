"""The figure of errors against state and command, which shows where a map or a controller is wrong."""

from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stepgap.records.run_folder import RunRecord
from stepgap.report.colours import BLUE, GREY, VERMILLION
from stepgap.report.figures import MOST_VECTORS, WIDTH, axis_label, unit_label

MOST_INPUTS: Final = 6
"""Largest number of coordinates against which errors are drawn, so that the panels can be read."""


def state_error_figure(record: RunRecord) -> Figure:
    """Tracking and prediction errors of the last deployment against the coordinates of state and command."""
    steps = record.steps.of_iteration(record.shown_iterations[-1]).tracking().completed()
    inputs = [*record.space.state, *record.space.command][:MOST_INPUTS]
    values = np.hstack([steps.state, steps.requested])
    rows = len(record.space.state)
    figure = Figure(figsize=(WIDTH, 0.7 + 1.7 * rows), layout="constrained")
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
    for row, quantity in enumerate(record.space.state):
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
