"""Draws what a walking robot made of its targets in a run, before and after learning: docs/velocity.png.

    ./go python -m benchmarks.velocity_figure runs/walk docs/velocity.png

Above: forward velocity and turning as targets, as they were with the command of the nominal map, and corrected. Below:
the error as a map, an arrow for each target from what was wanted to the mean of what was done.
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.report.drawing import BLUE, DOTS_PER_INCH, LIGHT, LOOK, VERMILLION, WIDTH
from stepgap.step import Quantity

SHOWN = (0, 2)
"""Numbers of the drawn states: forward velocity and turning."""


def draw_time(axes: Axes, quantity: Quantity, number: int, before: Steps, after: Steps) -> None:
    """Targets and velocities of all steps."""
    axes.step(np.arange(len(before)) + 1, before.target[:, number], LIGHT, where="mid", lw=4, label="target")
    for steps, colour, label in ((before, VERMILLION, "without correction"), (after, BLUE, "corrected")):
        axes.plot(np.arange(len(steps)) + 1, steps.next_state[:, number], color=colour, label=label)
    axes.set_ylabel(f"{quantity.name} [{quantity.unit}]")


def draw_map(axes: Axes, steps: Steps, colour: str, title: str) -> None:
    """An arrow for each target to the mean velocity of its steps but the first."""
    targets, number = np.unique(steps.target, axis=0, return_inverse=True)
    begins = np.append(True, np.any(np.diff(steps.target, axis=0) != 0, axis=1))
    kept = np.isfinite(steps.next_state).all(axis=1) & ~begins
    for index, target in enumerate(targets):
        here = kept & (number.ravel() == index)
        if here.any():
            done = steps.next_state[here].mean(axis=0)
            wanted = [target[each] for each in SHOWN]
            reached = [done[each] for each in SHOWN]
            axes.plot(*wanted, "o", color=LIGHT, ms=6)
            axes.plot(*reached, ",", color=colour)  # so that the axes reach it
            axes.annotate("", reached, wanted, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 1.2})
    axes.set_title(title, fontsize=8)


def draw(run: Run) -> Figure:
    """The figure of a run."""
    space, recorded = run.space, run.recorded
    before, after = recorded.of_iteration(0), recorded.of_iteration(int(recorded.iteration.max()))
    figure = Figure((WIDTH, 6.0), layout="constrained")
    grid = figure.add_gridspec(3, 2, height_ratios=(1, 1, 1.9))
    for row, number in enumerate(SHOWN):
        axes = figure.add_subplot(grid[row, :])
        draw_time(axes, space.state[number], number, before, after)
        if row == 0:
            axes.legend(ncols=3, loc="upper right", frameon=False)
    axes.set_xlabel("step")
    first = None
    for column, (steps, colour, title) in enumerate(
        (
            (before, VERMILLION, "from target to velocity, without correction"),
            (after, BLUE, "from target to velocity, corrected"),
        )
    ):
        first = axes = figure.add_subplot(grid[2, column], sharex=first, sharey=first)
        draw_map(axes, steps, colour, title)
        across, up = (space.state[number] for number in SHOWN)
        axes.set(xlabel=f"{across.name} [{across.unit}]", ylabel=f"{up.name} [{up.unit}]")
    return figure


def main() -> None:
    """Draws the figure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=Path)
    parser.add_argument("out", type=Path)
    given = parser.parse_args()
    from matplotlib import rc_context

    with rc_context(LOOK):
        draw(Run(given.run)).savefig(given.out, dpi=DOTS_PER_INCH)


if __name__ == "__main__":
    main()
