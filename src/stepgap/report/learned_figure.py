"""The figure of leave-one-out predictions of a residual: each error predicted from all others."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stepgap.base.normal import INTERVAL_95
from stepgap.report.colours import BLACK, BLUE, GREY
from stepgap.report.figures import MOST_VECTORS, WIDTH, axis_label, unit_label
from stepgap.report.learned import LearnedResidual
from stepgap.step import StepSpace

FARTHEST = 4.5
"""Number of standard deviations above which a point is drawn at the edge."""


def left_out_figure(space: StepSpace, learned: LearnedResidual) -> Figure:
    """Draws leave-one-out predictions against the errors, and their differences in standard deviations, by step."""
    count = len(space.state)
    figure = Figure(figsize=(WIDTH, 0.4 + 2.3 * count), layout="constrained")
    panels = figure.subplots(count, 2, squeeze=False, width_ratios=[1, 1.6])
    regressions, predictions = learned.residual.regressions, learned.leave_one_out
    parts = zip(panels, space.state, regressions, predictions, learned.standardised_errors, strict=True)
    for (square, wide), quantity, regression, (mean, _), standardised in parts:
        values = regression.values
        dots = {"linestyle": "", "marker": ".", "markersize": 3, "color": BLUE}
        fast = {"rasterized": len(mean) > MOST_VECTORS}
        square.plot(values, mean, **dots, **fast)
        ends = np.array([min(values.min(), mean.min()), max(values.max(), mean.max())])
        square.plot(ends, ends, color=BLACK, linewidth=0.8)
        name = axis_label(quantity, capital=False)
        square.set(xlabel=f"Error of the map in {name}", ylabel=f"Predicted{unit_label(quantity)}")
        square.set_aspect("equal", adjustable="datalim")
        square.xaxis.set_major_locator(MaxNLocator(4))
        wide.axhspan(-INTERVAL_95, INTERVAL_95, color="0.92", zorder=0)
        wide.axhline(0, color=GREY, linewidth=0.8)
        wide.plot(np.arange(1, len(standardised) + 1), np.clip(standardised, -FARTHEST, FARTHEST), **dots, **fast)
        wide.set(xlabel="Step, in recorded order", ylabel="(Error − predicted) / std")
        wide.set_ylim(-FARTHEST - 0.3, FARTHEST + 0.3)
        for panel in (square, wide):
            panel.spines[["top", "right"]].set_visible(False)
    return figure
