from collections.abc import Callable
from typing import Any

import pytest

from stepgap.records.missing import Missing
from stepgap.report import drawing, figures
from stepgap.report.drawing import Drawing, draw_figure
from tests.quick_runs import leave_out_files_of_figures


@pytest.fixture
def unplaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes stay where they are made: to place them takes longer than to draw the figures of the page."""
    monkeypatch.setattr(drawing, "_lay_out", lambda figure: figure.set_layout_engine(None))


@pytest.fixture
def files_of_few_figures(every_format: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn for the page, but the files of most are empty, since all are written in the same way."""
    monkeypatch.setattr(figures, "draw_figure", drawn_for_few)


def drawn_for_few(make: Callable[[], Any], subject: str) -> Drawing | Missing:
    """A figure, whose files are empty unless it is one of a few."""
    with pytest.MonkeyPatch.context() as patch:
        if subject not in ("the tracking", "the correction", "the sensitivity"):
            leave_out_files_of_figures(patch)
        return draw_figure(make, subject)
