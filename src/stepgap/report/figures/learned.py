"""The figures of the learned correction: its mean and standard deviation, and its leave-one-out predictions."""

from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.residual import Residual
from stepgap.records.missing import Missing
from stepgap.report.analysis import Analysis, centre_of
from stepgap.report.drawing import BLACK, BLUE, GREY, MOST_VECTORS, axis_label, new_figure, unit_label
from stepgap.report.figures import RunFigure
from stepgap.report.learned_residual import LearnedResidual
from stepgap.report.plots import clear_frame
from stepgap.step import Array, StepSpace

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

SURFACE_GRID: Final = 33  # Number of grid points along each input

SURFACE_MARGIN: Final = 0.05
"""Part of the range of the recorded values by which the drawn range is larger, on each side."""


def surface_figure(space: StepSpace, learned: LearnedResidual, centre: Array) -> "Figure":
    """Draws mean and standard deviation of the residual for each state coordinate, over two of its inputs.

    The two are those that change the mean most over the recorded points, while all other inputs keep the values of the
    centre. Inputs from the step before are zero.

    Args:
        learned: Residual with its points.
        centre: State and command; shape (n + m,).
    """
    residual = conditioned(learned)
    points = learned.residual.regressions[0].points[:, : len(centre)]
    quantities = [*space.state, *space.command]
    figure = new_figure(0.3 + 2.6 * len(space.state))
    grid_of_panels = figure.subplots(len(space.state), 2, squeeze=False)
    for row, (panels, quantity) in enumerate(zip(grid_of_panels, space.state, strict=True)):
        across, up = influential(residual, points, centre, row)
        x, y = (_range(points[:, index]) for index in (across, up))
        grid = np.broadcast_to(centre, (SURFACE_GRID, SURFACE_GRID, len(centre))).copy()
        grid[..., across], grid[..., up] = np.meshgrid(x, y)
        name = axis_label(quantity, capital=False)
        surfaces = {
            f"Correction of {name}": residual.mean(grid),
            f"Its standard deviation{unit_label(quantity)}": residual.std(grid),
        }
        for panel, (title, values) in zip(panels, surfaces.items(), strict=True):
            filled = panel.contourf(x, y, values[..., row], levels=12, cmap="cividis")
            figure.colorbar(filled, ax=panel, format="%.3g")
            dots = {"marker": ".", "markersize": 4, "markeredgecolor": "white", "markeredgewidth": 0.3, "linestyle": ""}
            fast = {"rasterized": points.size > MOST_VECTORS}
            panel.plot(points[:, across], points[:, up], **dots, **fast, color=BLACK, label="recorded step")
            panel.set(xlabel=axis_label(quantities[across]), ylabel=axis_label(quantities[up]))
            panel.set_title(title, loc="left", fontsize="medium")
    return figure


def conditioned(learned: LearnedResidual) -> Residual:
    """The residual as a function of state and command, after all its steps; inputs from the step before are zero."""
    n, m = learned.residual.sizes
    return learned.residual.conditioned_on(np.append(np.zeros(2 * n + m), learned.steps))


def influential(residual: Residual, points: Array, centre: Array, row: int) -> tuple[int, int]:
    """Indices of the two inputs along which the mean of one state coordinate varies most over the points (N, d)."""
    effects = []
    for index in range(len(centre)):
        moved = np.broadcast_to(centre, points.shape).copy()
        moved[:, index] = points[:, index]
        effects.append(float(np.std(residual.mean(moved)[:, row])))
    first, second, *_ = np.argsort(effects, kind="stable")[::-1]
    return min(int(first), int(second)), max(int(first), int(second))


def _range(values: Array) -> Array:
    """Grid over the range of recorded values, and a little more; shape (SURFACE_GRID,)."""
    low = float(values.min())
    high = float(values.max())
    margin = SURFACE_MARGIN * (high - low) or 1e-3 * max(abs(high), 1.0)
    return np.linspace(low - margin, high + margin, SURFACE_GRID)


_CAPTION = (
    "The learned correction, the expected error of the nominal map, and its standard deviation without noise, for each "
    "state coordinate over the two inputs that change it most.{} Points: recorded steps to which the model was fitted, "
    "with any values of the other inputs. Far from the points the correction is extrapolated."
)


def _caption(analysis: Analysis) -> str:
    gait = analysis.gait
    space = analysis.run.space
    at = "the median of these steps"
    if not isinstance(gait, Missing) and (point := gait.centre_point) is not None:
        what = "the limit cycle of" if point.held else "the step that ends nearest to"
        at = f"{what} the target {gait.centre_named}, the nearest to the median of all"
    return _CAPTION.format(f" All other inputs have their values at {at}." * (len(space.names) > 2))


SURFACE = RunFigure(
    "surface",
    "learned",
    6,
    "the correction",
    _caption,
    lambda analysis: surface_figure(
        analysis.run.space,
        analysis.run.needed(analysis.learned),
        centre_of(analysis.run.needed(analysis.learned), analysis.gait),
    ),
    lambda analysis: analysis.has_learned_steps,
)


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


_LEFT_OUT = (
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
    lambda analysis: _LEFT_OUT,
    lambda analysis: left_out_figure(analysis.run.space, analysis.run.needed(analysis.learned)),
    lambda analysis: analysis.has_learned_steps,
)
