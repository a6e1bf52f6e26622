import pytest

from stepgap.report import drawing


@pytest.fixture
def unplaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes stay where they are made: to place them takes longer than to draw the figures of the page."""
    monkeypatch.setattr(drawing, "_lay_out", lambda figure: figure.set_layout_engine(None))
