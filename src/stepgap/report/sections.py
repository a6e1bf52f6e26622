"""The figure of `stepgap steps`: every section that was found in the logs, and the signals about each doubtful one."""

from collections.abc import Mapping, Sequence
from io import BytesIO
from itertools import islice
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from stepgap.records.sections.signals import Signal
from stepgap.records.sections.step_extraction import ExtractedSteps
from stepgap.records.sections.steps_table import label_of
from stepgap.report.colours import BLACK, BLUE, LIGHT, VERMILLION
from stepgap.report.figures import plain
from stepgap.step import Array

SECTIONS_IN_ROW = 25
"""Number of sections in one row of the overview."""

MOST_OVERVIEW_ROWS, MOST_VIEWS, PANELS = 40, 20, 4
"""Largest numbers of rows of the overview, of doubtful sections, and of signals that are drawn about each."""

POINTS_IN_ROW = 4000
"""Number of samples that are drawn in a row."""

FOUND: dict[str, Any] = {"color": BLUE, "marker": "o", "linestyle": "", "markersize": 4, "label": "section"}
DOUBTFUL: dict[str, Any] = {"color": VERMILLION, "marker": "X", "linestyle": "", "markersize": 8, "label": "doubtful"}
LEFT_OUT: dict[str, Any] = {"color": LIGHT, "alpha": 0.35, "linewidth": 0, "label": "step that is left out"}


def sections_picture(logs: Sequence[ExtractedSteps], form: str) -> bytes:
    """Draws the sections on the signal in which they are seen; steps that are left out have a grey background.

    Args:
        logs: Steps of the logs.
        form: File format: pdf, png or svg.
    """
    rows = [(log, begin) for log in logs for begin in range(0, len(log.sections.time) - 1, SECTIONS_IN_ROW)]
    doubtful = [(log, number) for log in logs for number, doubt in enumerate(log.sections.doubts) if doubt]
    del rows[MOST_OVERVIEW_ROWS:], doubtful[MOST_VIEWS:]
    figure = Figure(figsize=(13, 0.8 + 1.8 * (len(rows) + len(doubtful))), layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.add_gridspec(len(rows) + len(doubtful), PANELS)
    legend: dict[str, Any] = {}
    for row, (log, begin) in enumerate(rows):
        end = min(begin + SECTIONS_IN_ROW, len(log.sections.time) - 1)
        margin = 0.6 * _typical_step(log)
        name, signal = next(iter(log.signals.items()))
        panel = figure.add_subplot(grid[row, :])
        _draw(panel, log, signal, log.sections.time[begin] - margin, log.sections.time[end] + margin)
        _title(panel, label_of(log), 9)
        panel.set_ylabel(plain(name))
        legend |= _legend_of(panel)
    for row, (log, number) in enumerate(doubtful, len(rows)):
        panels = [figure.add_subplot(grid[row, column]) for column in range(min(PANELS, len(log.signals)))]
        _draw_about(panels, log, number)
        legend |= _legend_of(panels[0])
    figure.legend(legend.values(), legend.keys(), loc="outside upper right", ncols=3, frameon=False)
    picture = BytesIO()
    figure.savefig(picture, format=form, dpi=110)
    return picture.getvalue()


def _draw_about(panels: Sequence[Any], log: ExtractedSteps, number: int) -> None:
    """The signals about a section."""
    time, around = float(log.sections.time[number]), 0.4 * _typical_step(log)
    for panel, (name, signal) in zip(panels, islice(log.signals.items(), PANELS), strict=False):
        _draw(panel, log, signal, time - around, time + around)
        panel.set_ylabel(plain(name))
    _title(panels[0], f"{time:.3f} s: {log.sections.doubts[number]}", 8)


def _draw(panel: Any, log: ExtractedSteps, signal: Signal, begin: float, end: float) -> None:
    """A signal from one time to another, the sections, and the steps that are left out."""
    part = signal.between(begin, end)
    stride = 1 + len(part) // POINTS_IN_ROW
    samples: Array = np.asarray(part.values, float)[::stride]
    panel.plot(part.time[::stride], samples, color=BLACK, linewidth=0.7, marker=".", markersize=1.5)
    times = log.sections.time
    values = np.interp(times, signal.time, np.asarray(signal.values, float))
    doubtful = np.array([bool(doubt) for doubt in log.sections.doubts])
    inside = (times >= begin) & (times <= end)
    for look, chosen in ((FOUND, inside & ~doubtful), (DOUBTFUL, inside & doubtful)):
        if chosen.any():
            panel.plot(times[chosen], values[chosen], **look)
    for number, fault in enumerate(log.faults):
        if fault and times[number] < end and times[number + 1] > begin:
            panel.axvspan(times[number], times[number + 1], **LEFT_OUT)
    panel.set(xlim=(begin, end), xlabel="Time [s]")
    panel.spines[["top", "right"]].set_visible(False)


def _title(panel: Any, text: str, size: int) -> None:
    """A title that may be longer than a label."""
    panel.set_title(" ".join(plain(word) for word in text.split()), loc="left", fontsize=size)


def _legend_of(panel: Any) -> Mapping[str, Any]:
    """Drawn objects by their label, each once."""
    handles, labels = panel.get_legend_handles_labels()
    return dict(zip(labels, handles, strict=True))


def _typical_step(log: ExtractedSteps) -> float:
    """Median time between sections [s]."""
    return float(np.median(np.diff(log.sections.time)))
