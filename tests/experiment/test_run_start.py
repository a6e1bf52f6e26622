"""The folder of a run before its first step."""

from datetime import datetime, tzinfo
from pathlib import Path

import pytest

from stepgap.experiment import run_start
from stepgap.experiment.run_start import run_folder


class Noon(datetime):
    """A clock that stands still."""

    @classmethod
    def now(cls, tz: tzinfo | None = None) -> "Noon":
        return cls(2026, 11, 25, 12, tzinfo=tz)


def test_two_runs_that_start_in_the_same_second_have_two_folders(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_start, "datetime", Noon)
    with run_folder(None) as first, run_folder(None) as second:
        assert [first, second] == [Path("runs/2026-11-25_12-00-00"), Path("runs/2026-11-25_12-00-00_2")]
        (second / "experiment.toml").touch()
    assert not first.exists(), "nothing was written into it"
    assert second.exists()


def test_a_refused_run_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    with run_folder(None) as folder:
        assert folder.is_dir()
    assert not list(tmp_path.iterdir())


def test_a_folder_that_was_chosen_is_not_made_before_the_run(tmp_path: Path) -> None:
    with run_folder(tmp_path / "out") as folder:
        assert folder == tmp_path / "out"
        assert not folder.exists()
