"""The figure of `stepgap steps`: every section that was found in the logs, and the signals about each doubtful one."""

from collections.abc import Sequence
from io import BytesIO
from itertools import islice
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from stepgap.logs.sections.signals import Signal
from stepgap.logs.sections.step_extraction import ExtractedSteps
from stepgap.logs.sections.steps_table import REFUSED, label_of
from stepgap.report.drawing import BLACK, BLUE, LIGHT, VERMILLION, plain
from stepgap.step import Array

SECTIONS_IN_ROW = 25  # Number of sections in one row of the overview

MOST_OVERVIEW_ROWS = 40  # Largest number of rows of the overview
MOST_VIEWS = 20  # Largest number of doubtful sections that are drawn
PANELS = 4  # Largest number of signals that are drawn about each of them

POINTS_IN_ROW = 4000  # Number of samples that are drawn in a row

FOUND: dict[str, Any] = {"color": BLUE, "marker": "o", "linestyle": "", "markersize": 4, "label": "section"}
DOUBTFUL: dict[str, Any] = {"color": VERMILLION, "marker": "X", "linestyle": "", "markersize": 8, "label": "doubtful"}
_LEFT_OUT: dict[str, Any] = {"color": LIGHT, "alpha": 0.35, "linewidth": 0, "label": "step that is left out"}


def sections_picture(logs: Sequence[ExtractedSteps], form: str) -> bytes:
    """Draws sections, as pdf, png or svg, on the signal in which they are seen; steps that are left out are grey."""
    rows = [(log, begin) for log in logs for begin in range(0, len(log.sections.time) - 1, SECTIONS_IN_ROW)]
    doubtful = [(log, number) for log in logs for number, doubt in enumerate(log.sections.doubts) if doubt]
    del rows[MOST_OVERVIEW_ROWS:], doubtful[MOST_VIEWS:]
    figure = Figure(figsize=(13, 0.8 + 2 * (len(rows) + len(doubtful))), layout="constrained")
    parts = figure.subfigures(len(rows) + len(doubtful), 1, squeeze=False)[:, 0].tolist()
    panels = [_draw_overview(part, log, begin) for part, (log, begin) in zip(parts, rows, strict=False)]
    panels += [_draw_about(part, log, number) for part, (log, number) in zip(parts[len(rows) :], doubtful, strict=True)]
    legend = {label: drawn for panel in panels for drawn, label in zip(*panel.get_legend_handles_labels(), strict=True)}
    figure.legend(legend.values(), legend.keys(), loc="outside upper right", ncols=3, frameon=False)
    picture = BytesIO()
    title = REFUSED if any(log.refusal for log in logs) else "Sections of a log"
    figure.savefig(picture, format=form, dpi=110, metadata={"Title": title})
    return picture.getvalue()


def _draw_overview(part: Any, log: ExtractedSteps, begin: int) -> Any:
    end = min(begin + SECTIONS_IN_ROW, len(log.sections.time) - 1)
    margin = 0.6 * _typical_step(log)
    name, signal = next(iter(log.signals.items()))
    panel = part.subplots()
    _draw(panel, log, signal, log.sections.time[begin] - margin, log.sections.time[end] + margin)
    panel.set_ylabel(plain(name))
    _title(part, label_of(log))
    return panel


def _draw_about(part: Any, log: ExtractedSteps, number: int) -> Any:
    time = float(log.sections.time[number])
    around = 0.6 * _typical_step(log)
    panels = part.subplots(1, PANELS, squeeze=False)[0]
    for panel, (name, signal) in zip(panels, islice(log.signals.items(), PANELS), strict=False):
        _draw(panel, log, signal, time - around, time + around)
        panel.set_ylabel(plain(name))
    for panel in panels[len(log.signals) :]:
        panel.set_axis_off()
    _title(part, f"{label_of(log)}, {time:.3f} s: {log.sections.doubts[number]}")
    return panels[0]


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
            panel.axvspan(times[number], times[number + 1], **_LEFT_OUT)
    panel.set(xlim=(begin, end), xlabel="Time [s]")
    panel.spines[["top", "right"]].set_visible(False)


def _title(part: Any, text: str) -> None:
    """A title that may be longer than a label."""
    part.suptitle(" ".join(plain(word) for word in text.split()), x=0.01, ha="left", fontsize=9)


def _typical_step(log: ExtractedSteps) -> float:
    """Median time between sections [s]."""
    return float(np.median(np.diff(log.sections.time)))
