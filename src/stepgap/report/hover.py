"""The values of a figure's curves, which the page shows where the pointer is."""

import json
from importlib.resources import files
from typing import Any, Final

import numpy as np

HOVER_SCRIPT: Final = files("stepgap.report").joinpath("hover.js").read_text(encoding="utf-8")
"""Script that shows the values; it does nothing on a page without figures."""

MOST_VALUES: Final = 2000
"""Number of points above which the values of a curve are not on the page, so that it stays small."""


def hover_values(figure: Any) -> str:
    """The curves of a figure that is laid out, as JSON for `hover.js`.

    It is a list of panels. A panel has its `box` (left, top, right, bottom, as fractions of the figure), its axes `x`
    and `y` (lower end, upper end, whether it is logarithmic, label) and its `curves` (label, x and y of the points, as
    text of four digits).

    Args:
        figure: A `matplotlib.figure.Figure`.
    """
    panels = [_panel(axes) for axes in figure.axes]
    return json.dumps([panel for panel in panels if panel["curves"]], separators=(",", ":"), ensure_ascii=False)


def _panel(axes: Any) -> dict[str, Any]:
    box = axes.get_position()
    return {
        "box": [round(float(edge), 4) for edge in (box.x0, 1 - box.y1, box.x1, 1 - box.y0)],
        "x": [*map(float, axes.get_xlim()), axes.get_xscale() == "log", _shared_label(axes)],
        "y": [*map(float, axes.get_ylim()), axes.get_yscale() == "log", _plain(axes.get_ylabel())],
        "curves": [curve for line in axes.lines if line.get_transform() == axes.transData for curve in _curve(line)],
    }


def _curve(line: Any) -> list[list[Any]]:
    """Label and points of a line; nothing if there are none or too many."""
    points = np.column_stack([np.asarray(values, float) for values in (line.get_xdata(), line.get_ydata())])
    points, label = points[np.isfinite(points).all(axis=1)], str(line.get_label())
    if not 0 < len(points) <= MOST_VALUES:
        return []
    values = [[f"{value:.4g}" for value in column] for column in points.T]
    return [["" if label.startswith("_") else _plain(label), *values]]


def _shared_label(axes: Any) -> str:
    """Label of the horizontal axis, which only the lowest of several panels shows."""
    labels = [axes.get_xlabel(), *(each.get_xlabel() for each in axes.get_shared_x_axes().get_siblings(axes))]
    return _plain(next(filter(None, labels), ""))


def _plain(text: str) -> str:
    """Text of a label in one line."""
    return " ".join(text.replace("\\$", "$").split())
