"""The figure of `stepgap steps`: every section that was found in the logs, and a closer view of each doubtful one."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from stepgap.records.sections.step_extraction import ExtractedSteps
from stepgap.report.colours import BLACK, BLUE, LIGHT, VERMILLION
from stepgap.report.figures import plain

SECTIONS_IN_ROW = 25
"""Number of sections in one row of the overview."""

MOST_ROWS, MOST_VIEWS, VIEWS_IN_ROW = 40, 40, 4
"""Largest numbers of rows and of closer views, and the number of views side by side."""

POINTS_IN_ROW = 4000
"""Number of samples that are drawn in a row."""

FOUND: dict[str, Any] = {"color": BLUE, "marker": "o", "linestyle": "", "markersize": 4, "label": "section"}
DOUBTFUL: dict[str, Any] = {"color": VERMILLION, "marker": "X", "linestyle": "", "markersize": 8, "label": "doubtful"}


def sections_picture(logs: Sequence[ExtractedSteps], form: str) -> bytes:
    """Draws the sections on the signal in which they are seen; steps that are left out have a grey background.

    Args:
        logs: Steps of the logs.
        form: File format: pdf, png or svg.
    """
    rows = [(log, begin) for log in logs for begin in range(0, len(log.sections.time) - 1, SECTIONS_IN_ROW)][:MOST_ROWS]
    doubtful = [(log, number) for log in logs for number, doubt in enumerate(log.sections.doubts) if doubt][:MOST_VIEWS]
    view_rows = -(-len(doubtful) // VIEWS_IN_ROW)
    figure = Figure(figsize=(13, 0.8 + 1.7 * len(rows) + 2.2 * view_rows), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(rows) + view_rows, VIEWS_IN_ROW)
    for row, (log, begin) in enumerate(rows):
        panel = figure.add_subplot(grid[row, :])
        end = min(begin + SECTIONS_IN_ROW, len(log.sections.time) - 1)
        margin = 0.6 * float(np.median(np.diff(log.sections.time)))
        _draw(panel, log, log.sections.time[begin] - margin, log.sections.time[end] + margin)
        panel.set_title(plain(log.source), loc="left", fontsize=9)
        if row == 0:
            figure.legend(*panel.get_legend_handles_labels(), loc="outside upper right", ncols=3, frameon=False)
    for place, (log, number) in enumerate(doubtful):
        panel = figure.add_subplot(grid[len(rows) + place // VIEWS_IN_ROW, place % VIEWS_IN_ROW])
        time, around = log.sections.time[number], 0.4 * float(np.median(np.diff(log.sections.time)))
        _draw(panel, log, time - around, time + around)
        panel.set_title(f"{time:.3f} s: {plain(log.sections.doubts[number])}", loc="left", fontsize=7, wrap=True)
    picture = BytesIO()
    figure.savefig(picture, format=form, dpi=110)
    return picture.getvalue()


def _draw(panel: Any, log: ExtractedSteps, begin: float, end: float) -> None:
    """The signal from one time to another, its sections, and the steps that are left out."""
    part = log.shown.between(begin, end)
    values = np.asarray(part.values, float)
    stride = 1 + len(part) // POINTS_IN_ROW
    panel.plot(part.time[::stride], values[::stride], color=BLACK, linewidth=0.7, marker=".", markersize=1.5)
    times = log.sections.time
    shown = np.interp(times, log.shown.time, np.asarray(log.shown.values, float))
    doubtful = np.array([bool(doubt) for doubt in log.sections.doubts])
    inside = (times >= begin) & (times <= end)
    for look, chosen in ((FOUND, inside & ~doubtful), (DOUBTFUL, inside & doubtful)):
        panel.plot(times[chosen], shown[chosen], **look)
    first = True
    for number, fault in enumerate(log.faults):
        if fault and times[number] < end and times[number + 1] > begin:
            label = "step that is left out" if first else None
            panel.axvspan(times[number], times[number + 1], color=LIGHT, alpha=0.35, linewidth=0, label=label)
            first = False
    panel.set(xlim=(begin, end), ylabel=plain(log.shown_name), xlabel="Time [s]")
    panel.spines[["top", "right"]].set_visible(False)
