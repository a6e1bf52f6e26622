"""A figure that cannot be drawn is replaced by the reason."""

import builtins
from pathlib import Path

import pytest

from stepgap.records.missing import Missing
from stepgap.report.drawing import LONGEST_ERROR, draw_figure
from tests.report.pages import Page, check_alone
from tests.report.runs import report_of, write_run


def test_the_reason_is_one_short_line() -> None:
    def fail() -> None:
        raise OSError("no font\n" * 100)

    missing = draw_figure(fail, "errors")
    assert isinstance(missing, Missing)
    assert missing.reason.startswith("no figure of errors could be drawn (OSError: no font no font")
    assert "pip install --force-reinstall matplotlib" in missing.reason
    assert len(missing.reason) < 250 + LONGEST_ERROR


def test_a_report_needs_no_matplotlib(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    imported = builtins.__import__

    def without(name: str, *rest: object) -> object:
        if name.startswith(("matplotlib", "stepgap.report.figures", "stepgap.report.state_figure")):
            raise ImportError("libfreetype.so.6: cannot open shared object file")
        return imported(name, *rest)  # pyright: ignore[reportArgumentType]

    folder = write_run(tmp_path / "run", ("x",), steps=3)
    monkeypatch.setattr(builtins, "__import__", without)
    page = Page(report_of(folder))
    check_alone(page, 0)
    assert page.text.count("could be drawn (ImportError: libfreetype.so.6") == 5
    assert not (folder / "figures").exists()
