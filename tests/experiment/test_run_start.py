"""The folder of a run before its first step."""

from datetime import datetime, tzinfo
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.cli.app import main
from stepgap.control.command_table import build_table
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment import run_start
from stepgap.experiment.nominal import Nominal, check_surrogate
from stepgap.experiment.plants import PlantRequest
from stepgap.experiment.run_start import discard_unrecorded, load_setup, run_folder
from stepgap.experiment.settings import Experiment
from stepgap.robots.nominal_maps.surrogate_map import fit_surrogate
from stepgap.step import Array
from tests.control.maps import LossyHopper, PitchingHopper


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


class Coin(LossyHopper):
    """A simulator whose next height is a coin toss, so that nothing can be learned of it."""

    def next_state(self, state: Array, command: Array) -> Array:
        found = super().next_state(state, command)
        toss = np.sin(1e6 * (state[..., 1] + command[..., 1]))
        return np.stack([found[..., 0], 0.58 + 0.1 * toss], axis=-1)


def test_a_surrogate_that_predicts_nothing_is_refused_with_its_error() -> None:
    poor, good = (fit_surrogate(step_map, np.random.default_rng(0)) for step_map in (Coin(), LossyHopper()))
    with pytest.raises(InputError, match=r"predicts height \d\.\d+ half ranges wrongly .* 0 of its \d+ simulated"):
        check_surrogate(poor)
    check_surrogate(good)


def test_a_table_needs_all_targets(tmp_path: Path) -> None:
    reference = Reference.from_segments(("speed", "height"), [(1, (0.2, np.nan))], 3)
    request = PlantRequest(Experiment(control=ControlSettings(table=3)), reference, tmp_path)
    with pytest.raises(InputError, match=r"control\.table: a table needs a target"):
        load_setup(request, LossyHopper())
    with pytest.raises(InputError, match="pitch has another one"):
        build_table(PitchingHopper(), 2)


def test_the_steps_of_a_simulator_are_kept_if_the_run_does_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "far.csv").write_text("speed\n9\n")
    nominal = Nominal(LossyHopper(), fit_surrogate(LossyHopper(), np.random.default_rng(0)))
    monkeypatch.setattr("stepgap.cli.nominal.nominal_with_progress", lambda settings, reference: nominal)
    for name in ("nominal_map.json", "nominal_map_2.json"):
        with pytest.raises(SystemExit) as end:
            main(["run", "--reference", "far.csv"])
        assert end.value.code == 2
        assert "out of reach" in (message := capsys.readouterr().err)
        assert message.endswith(f" (its simulated steps are kept: --nominal.file {name})\n")
        assert (tmp_path / name).read_text() == nominal.file
    assert not (tmp_path / "runs").exists()


def test_a_run_that_does_not_start_removes_nothing_through_a_link(tmp_path: Path) -> None:
    run, others = tmp_path / "run", tmp_path / "others"
    for folder in (run, others):
        folder.mkdir()
    (run / "experiment.toml").touch()
    (others / "mine.json").touch()
    (run / "models").symlink_to(others)
    discard_unrecorded(run)
    assert (others / "mine.json").exists()
    assert not (run / "experiment.toml").exists()
