"""The figure of leave-one-out predictions of a residual: each error predicted from all others."""

from typing import TYPE_CHECKING

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.report.drawing import BLACK, BLUE, GREY, MOST_VECTORS, axis_label, new_figure, unit_label
from stepgap.report.figures import RunFigure
from stepgap.report.learned_residual import LearnedResidual
from stepgap.report.plots import clear_frame
from stepgap.step import StepSpace

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

FARTHEST = 4.5  # Number of standard deviations above which a point is drawn at the edge


def left_out_figure(space: StepSpace, learned: LearnedResidual) -> "Figure":
    """Draws leave-one-out predictions against the errors, and their differences in standard deviations, by step."""
    from matplotlib.ticker import MaxNLocator

    count = len(space.state)
    figure = new_figure(0.4 + 2.3 * count)
    panels = figure.subplots(count, 2, squeeze=False, width_ratios=[1, 1.6])
    regressions = learned.residual.regressions
    predictions = learned.leave_one_out
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
            clear_frame(panel)
    return figure


_CAPTION = (
    "Leave-one-out: each recorded error of the map, predicted by the model from all the others, with the same "
    "hyper-parameters. Left: on the line, prediction and record are equal. Right: their difference, in standard "
    "deviations of the prediction, noise included; the grey band should contain 95 % of the points, without a trend "
    "over the steps. Points beyond ±4.5 are drawn at the edge."
)

LEFT_OUT = RunFigure(
    "left_out",
    "learned",
    7,
    "the leave-one-out residuals",
    lambda analysis: _CAPTION,
    lambda analysis: left_out_figure(analysis.run.space, analysis.run.needed(analysis.learned)),
    lambda analysis: analysis.has_learned_steps,
)
