import pytest

from stepgap.sweep.report import page
from tests.report.conftest import drawn_for_few
from tests.report.conftest import unplaced as unplaced  # fixtures


@pytest.fixture
def files_of_few_figures(every_format: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Figures are drawn for the page, but the files of most are empty, since all are written in the same way."""
    monkeypatch.setattr(page, "draw_figure", drawn_for_few)
