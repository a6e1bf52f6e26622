"""How well the Gaussian processes predict what they learnt from: each error from all others."""

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from stepgap.learning.gaussian_process import leave_one_out
from stepgap.report.bands import INTERVAL
from stepgap.report.figures import BLACK, BLUE, GREY, MOST_VECTORS, WIDTH, axis_label, unit_label
from stepgap.report.learnt import Learnt, surprise
from stepgap.step import StepSpace

FARTHEST = 4.5
"""Standard deviations beyond which a residual is drawn at the edge."""


def left_out_figure(space: StepSpace, learnt: Learnt) -> Figure:
    """Leave-one-out predictions against the errors, and what is left in standard deviations, hop by hop."""
    count = len(space.state)
    figure = Figure(figsize=(WIDTH, 0.4 + 2.3 * count), layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(count, 2, squeeze=False, width_ratios=[1, 1.6])
    for (square, wide), quantity, process in zip(panels, space.state, learnt.processes, strict=True):
        mean, _ = leave_one_out(process)
        dots = {"linestyle": "", "marker": ".", "markersize": 3, "color": BLUE}
        fast = {"rasterized": len(mean) > MOST_VECTORS}
        square.plot(process.values, mean, **dots, **fast)
        ends = np.array([min(process.values.min(), mean.min()), max(process.values.max(), mean.max())])
        square.plot(ends, ends, color=BLACK, linewidth=0.8)
        name = axis_label(quantity, capital=False)
        square.set(xlabel=f"Map's error of {name}", ylabel=f"Predicted{unit_label(quantity)}")
        square.set_aspect("equal", adjustable="datalim")
        square.xaxis.set_major_locator(MaxNLocator(4))
        left = surprise(process)
        wide.axhspan(-INTERVAL, INTERVAL, color="0.92", zorder=0)
        wide.axhline(0, color=GREY, linewidth=0.8)
        wide.plot(np.arange(1, len(left) + 1), np.clip(left, -FARTHEST, FARTHEST), **dots, **fast)
        wide.set(xlabel="Hop, in the order recorded", ylabel="(Error − predicted) / std")
        wide.set_ylim(-FARTHEST - 0.3, FARTHEST + 0.3)
        for panel in (square, wide):
            panel.spines[["top", "right"]].set_visible(False)
    return figure
