"""Verbs of logs draw no figures unless a test looks at them."""

import pytest

PNG = b"\x89PNG"


@pytest.fixture(autouse=True)
def _no_figure_of_sections(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if "drawn_page" not in request.fixturenames:
        monkeypatch.setattr("stepgap.logs.sections.section_figures.sections_picture", lambda *_: PNG)
