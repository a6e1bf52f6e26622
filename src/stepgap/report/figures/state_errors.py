"""The figure of errors against state and command, which shows where a map or a controller is wrong."""

from collections.abc import Sequence
from textwrap import wrap
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from stepgap.experiment.run import Run
from stepgap.learning.steps import Steps
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import BLUE, GREY, MOST_VECTORS, VERMILLION, WIDTH, axis_label, new_figure
from stepgap.report.figures import RunFigure
from stepgap.report.plots import clear_frame
from stepgap.step import Array, Quantity

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

MOST_SHOWN: Final = 6
"""Largest number of coordinates against which errors are drawn, and of those whose errors are."""

MOST_COMMANDS: Final = 3  # Number of commands among them, if there are too many coordinates
LETTERS_PER_LINE: Final = 14  # Largest number of letters in a line of a label
SAME: Final = 1e-3  # Difference of two states that is not visible [half ranges]

WIDE_TICK: Final = 0.75
"""Width that a number on the horizontal axis may need, with the space beside it [inches]."""


def state_error_figure(run: Run) -> "Figure":
    """Tracking and prediction errors of the last deployment against the coordinates of state and command."""
    steps = _steps(run)
    rows, columns = shown_coordinates(steps)
    kinds = {
        "tracking error, next state − target": (steps.next_state - steps.target, VERMILLION, "o"),
        "error of the prediction, next state − predicted": (steps.next_state - steps.predicted, BLUE, "."),
    }
    dots: dict[str, Any] = {
        "linestyle": "",
        "markersize": 3,
        "markerfacecolor": "none",
        "markeredgewidth": 0.5,
        "rasterized": len(steps) * len(kinds) * len(rows) * len(columns) > MOST_VECTORS,
    }
    figure = new_figure(0.7 + (1.7 if len(rows) < 4 else 1.25) * len(rows))
    panels = figure.subplots(len(rows), len(columns), squeeze=False, sharex="col", sharey="row")
    for line, row in zip(panels, rows, strict=True):
        for panel, column in zip(line, columns, strict=True):
            panel.axhline(0, color=GREY, linewidth=0.8)
            for label, (error, colour, marker) in kinds.items():
                panel.plot(_inputs(steps)[:, column], error[:, row], marker, color=colour, label=label, **dots)
            clear_frame(panel)
    _label(figure, panels, [run.space.state[row] for row in rows], [_quantities(steps)[column] for column in columns])
    return figure


def shown_coordinates(steps: Steps) -> tuple[list[int], list[int]]:
    """Indices of the state coordinates whose errors are drawn, and of those of state and command on the axes.

    If there are too many, they are the coordinates with the largest errors in half ranges, and the commands and the
    states with which the errors vary most.
    """
    n = len(steps.space.state)
    m = len(steps.space.command)
    error = np.nan_to_num((steps.next_state - steps.target) / steps.space.state_scale)  # none without a target
    rows = _largest(np.sum(error**2, axis=0), MOST_SHOWN)
    varies = _correlation(_inputs(steps), error[:, rows])
    commands = _largest(varies[n:], max(MOST_COMMANDS, MOST_SHOWN - n))
    states = _largest(varies[:n], MOST_SHOWN - min(m, len(commands)))
    return rows, [*states, *(n + column for column in commands)]


def _largest(values: Array, count: int) -> list[int]:
    """Indices of the largest values, in ascending order of the indices."""
    return sorted(np.argsort(-np.nan_to_num(values), kind="stable")[:count].tolist())


def _correlation(inputs: Array, errors: Array) -> Array:
    """Largest magnitude of the correlation of each input (N, d) with the errors (N, k); shape (d,)."""
    if not len(inputs):
        return np.zeros(inputs.shape[1])
    centred = [values - values.mean(axis=0) for values in (inputs, errors)]
    sizes = [np.linalg.norm(values, axis=0) for values in centred]
    product = np.abs(centred[0].T @ centred[1])
    size = np.outer(*sizes)
    return np.divide(product, size, out=np.zeros_like(product), where=size > 0).max(axis=1)


def _steps(run: Run) -> Steps:
    """The steps whose errors are drawn."""
    return run.steps.of_iteration(run.shown_iterations[-1]).tracking().completed()


def _inputs(steps: Steps) -> Array:
    """State at the start of each step, and requested command; shape (N, n + m)."""
    return np.hstack([steps.state, steps.requested])


def _quantities(steps: Steps) -> list[Quantity]:
    return [*steps.space.state, *steps.space.command]


def _label(figure: "Figure", panels: Any, rows: Sequence[Quantity], columns: Sequence[Quantity]) -> None:
    """Labels that do not touch each other, however many panels there are."""
    from matplotlib.ticker import MaxNLocator

    ticks = max(1, int(WIDTH / len(columns) / WIDE_TICK))
    for panel, quantity in zip(panels[:, 0], rows, strict=True):
        panel.yaxis.set_major_locator(MaxNLocator(4, prune="both"))
        _name(panel.yaxis, f"Error of\n{_in_lines(axis_label(quantity, capital=False))}")
    for panel, quantity in zip(panels[-1], columns, strict=True):
        panel.xaxis.set_major_locator(MaxNLocator(ticks, prune="both" if ticks > 1 else None))
        _name(panel.xaxis, _in_lines(axis_label(quantity)))
    figure.align_labels(panels)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=2, frameon=False)


def _name(axis: Any, label: str) -> None:
    """Sets the label of an axis, with factor and constant of its numbers, which would be printed over others."""
    formatter = axis.get_major_formatter()
    formatter.set_powerlimits((-3, 4))
    formatter.set_locs(axis.get_majorticklocs())
    offset = formatter.get_offset()
    times = "×" * offset[:1].isdigit()
    axis.set_label_text(f"{label}\n{times}{offset}".strip())
    axis.get_offset_text().set_visible(False)


def _in_lines(label: str) -> str:
    """A label of a name and its unit in lines of equal length."""
    return "\n".join(wrap(label, LETTERS_PER_LINE))


def _caption(analysis: Analysis) -> str:
    steps = _steps(analysis.run)
    rows, columns = shown_coordinates(steps)
    text = (
        f"Errors in deployment {analysis.run.shown_iterations[-1]} against the state at the start of each step and the "
        "command. Errors that depend on a coordinate show what the map, or the controller, does not take into account."
    )
    if (np.abs(steps.predicted - steps.target) <= SAME * steps.space.state_scale)[:, rows].any():
        text += (
            " Where the map predicted that the target would be reached, the two errors are equal: dots are in circles."
        )
    hidden = [quantity.name for column, quantity in enumerate(_quantities(steps)) if column not in columns]
    if hidden:
        text += f" Not drawn, because the errors vary less with them: {', '.join(hidden)}."
    if len(rows) < len(steps.space.state):
        text += f" Only the {len(rows)} state coordinates with the largest errors have a row."
    return text


STATE_ERRORS = RunFigure(
    "state_errors",
    "figures",
    4,
    "the errors against state and command",
    _caption,
    lambda analysis: state_error_figure(analysis.run),
)
