from pathlib import Path

import pytest

from stepgap.report import drawing
from tests.report.runs import make_run


@pytest.fixture(scope="session")
def hopper_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of three deployments, which tests only read."""
    return make_run(tmp_path_factory.mktemp("hopper") / "run")


@pytest.fixture
def unplaced(monkeypatch: pytest.MonkeyPatch) -> None:
    """Axes stay where they are made: to place them takes longer than to draw the figures of the page."""
    monkeypatch.setattr(drawing, "_lay_out", lambda figure: figure.set_layout_engine(None))
