"""A figure of the report is one file: nothing else has to be changed for it."""

from pathlib import Path

import pytest

from stepgap.report import figures
from stepgap.report.figures import run_figures
from stepgap.report.page import CONTENTS
from tests.report.pages import Page
from tests.report.runs import report_of, write_run

ALTITUDE = """
from stepgap.report.drawing import new_figure
from stepgap.report.figures import RunFigure


def draw(analysis):
    figure = new_figure(2.0)
    figure.subplots().plot(analysis.run.steps.next_state)
    return figure


ALTITUDE = RunFigure("altitude", "figures", 1.5, "the altitude", lambda analysis: "How high it was.", draw)
"""


def test_a_new_figure_is_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "package").mkdir()
    (tmp_path / "package" / "altitude.py").write_text(ALTITUDE)
    monkeypatch.setattr(figures, "__path__", [*figures.__path__, str(tmp_path / "package")])
    page = Page(report_of(write_run(tmp_path / "run", ("x",), steps=3)))
    captions = ["Tracking without", "How high it was.", "Requested commands"]
    places = [page.text.index(caption) for caption in captions]
    assert places == sorted(places), "it stands after the first figure"
    assert {path.name for path in (tmp_path / "run" / "figures").glob("altitude.*")} == {"altitude.pdf", "altitude.png"}


def test_every_figure_has_a_section_and_a_place_of_its_own() -> None:
    found = run_figures()
    assert {figure.section for figure in found} <= set(CONTENTS)
    assert len({(figure.section, figure.place) for figure in found}) == len(found) == 8
