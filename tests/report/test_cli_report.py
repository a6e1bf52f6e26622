"""`stepgap report`: the replay is simulated once, several runs are compared, and bad input does no harm."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import tomli_w

from stepgap.experiment.replay import find_kinematics, replay
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.hardware.realtime.realtime_plant import RealtimePlant
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog
from stepgap.records.missing import Missing
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.twin import Twin
from tests.cli.command_line import Command, CommandResult, refused
from tests.rig_ticks import LOG_UNITS, rig_rows
from tests.sweep.report.tables import combinations_of, write_results_table


@pytest.fixture(scope="module")
def finished(run_folder: Path) -> Path:
    """A run of two deployments of four steps."""
    return run_folder


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """Reports are made without figures, which takes half as long."""
    monkeypatch.setattr("stepgap.report.figures.draw_figure", lambda *_: Missing("left out"))


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def test_a_run_has_a_replay_and_its_settings(finished: Path) -> None:
    text = (finished / "report.html").read_text(encoding="utf-8")
    assert '<canvas id="replay-canvas"' in text
    assert [int(number) for number in re.findall(r'"deployment":(\d)', text)] == [0, 1]
    assert '<tr><th scope="row">learning.iterations</th><td>1</td><td>4</td></tr>' in text
    assert len(text) < 1_000_000


def test_the_report_of_a_finished_run_builds_no_plant_and_no_twin(
    finished: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    def built(*_: object, **__: object) -> None:
        pytest.fail("a plant or a twin was built")

    shutil.copytree(finished, "run")
    for kind in (Twin, RigPlant, ModelPlant, RealtimePlant):
        monkeypatch.setattr(kind, "__init__", built)
    monkeypatch.setattr("stepgap.robots.hopper.twin.twin.build_model", built)
    assert stepgap("report", "run") == CommandResult(0, "run/report.html\n", "")
    assert contents(Path("run")) == contents(finished)


@pytest.mark.usefixtures("no_figures", "no_repeats")
def test_what_a_run_learned_in_its_only_deployment_is_described(finished: Path, stepgap: Command) -> None:
    shutil.copy(finished.parent / "targets.csv", "targets.csv")
    run = ["run", "--reference", "targets.csv", "--online", "--explore", "6", "--iterations", "0", "--out", "run"]
    assert stepgap(*run, "--prior", "none").code == 0
    assert [each.name for each in Path("run/models").iterdir()] == ["iteration_0.json"], "what is believed beforehand"
    text = Path("run/report.html").read_text(encoding="utf-8")
    assert "A further deployment would begin with the residual" in text
    assert "of 10 earlier steps" in text, "without the hop from rest"
    assert "Corrected map: " in text


@pytest.mark.parametrize("damage", [b"", b"foreign"])
def test_a_damaged_replay_is_computed_again(finished: Path, stepgap: Command, damage: bytes) -> None:
    shutil.copytree(finished, "run")
    Path("run/replay/deployment_1.npz").write_bytes(damage)
    assert stepgap("report", "run") == CommandResult(0, "run/report.html\n", "")
    assert contents(Path("run")) == contents(finished)


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("damage", [None, "[derivatives.speed]\nfx = 'x'\n"])
def test_a_report_without_its_nominal_map_has_all_other_parts(
    finished: Path, stepgap: Command, damage: str | None
) -> None:
    shutil.copytree(finished, "run")
    settings = Path("run/experiment.toml").read_text()
    begin, end = settings.index("[nominal]"), settings.index("[learning]")
    nominal = '[nominal]\nkind = "template"\nfile = "nominal_map.toml"\n\n'
    Path("run/experiment.toml").write_text(settings[:begin] + nominal + settings[end:])
    if damage:
        Path("run/nominal_map.toml").write_text(damage)
    result = stepgap("report", "run")
    assert (result.code, result.out) == (0, "run/report.html\n"), result.err
    assert result.err.startswith("stepgap: missing in the report: gait (")
    assert "nominal_map.toml: " in result.err
    page = Path("run/report.html").read_text()
    assert "Not available: " in page
    assert '<canvas id="replay-canvas"' in page
    assert "Error of speed [m/s]" in page


@pytest.mark.usefixtures("no_figures", "no_repeats")
def test_a_run_keeps_its_motion_and_simulates_nothing_twice(
    finished: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("stepgap.experiment.replay.replay", lambda *_: pytest.fail("simulated again"))
    settings = [finished / "experiment.toml", "--reference", finished.parent / "targets.csv"]
    assert stepgap("run", *settings, "--out", "run", "--quiet") == CommandResult(0, "run/report.html\n", "")


@pytest.mark.usefixtures("no_figures")
def test_a_rigs_motion_comes_from_its_tick_logs(
    finished: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(finished, "run")
    shutil.rmtree("run/replay")
    kinematics = find_kinematics(Experiment())
    for iteration in (0, 1):
        ticks = replay(Run(finished), iteration)
        rows = rig_rows(ticks.selected(TICK_UNITS).rows, RigState.STEP)
        with TickLog(Path(f"run/ticks/ticks-{iteration}.mcap"), LOG_UNITS) as log:
            log.append(rows)
    settings = Path("run/experiment.toml")
    settings.write_text(settings.read_text().replace('plant = "twin"', 'plant = "ethercat"'))
    result = stepgap("report", "run")
    assert result.err == "stepgap: missing in the report: replay (.: Is a directory; give an existing TOML file)\n"
    monkeypatch.setattr("stepgap.experiment.replay.find_kinematics", lambda settings: kinematics)
    assert stepgap("report", "run") == CommandResult(0, "run/report.html\n", "")
    for iteration in (0, 1):
        name = f"replay/deployment_{iteration}.npz"
        with np.load(finished / name) as simulated, np.load(Path("run") / name) as logged:
            for channel in ("step", "positions", "touching", "ground"):
                shown = logged[channel]
                np.testing.assert_array_equal(shown, simulated[channel][: len(shown)])
    Path("run/ticks/ticks-0.mcap").unlink()
    shutil.rmtree("run/replay")
    result = stepgap("report", "run")
    assert result.code == 0
    assert "missing in the report: replay (run/ticks/ticks-0.mcap: No such file" in result.err


@pytest.mark.usefixtures("no_figures")
def test_missing_parts_are_reported(finished: Path, stepgap: Command) -> None:
    Path("run").mkdir()
    rows = (finished / "steps.csv").read_text()
    Path("run/steps.csv").write_text(rows[:-9])
    result = stepgap("report", "run")
    assert (result.code, result.out) == (0, "run/report.html\n")
    assert result.err == (
        "stepgap: missing in the report: the last line of steps.csv (it is cut off); errors (no deployment is "
        "finished according to summary.json); the learned model (there is no models/iteration_1.json); settings, gait "
        "and replay (the folder contains no experiment.toml)\n"
    )


@pytest.mark.usefixtures("no_figures")
def test_steps_that_cannot_be_reproduced_have_no_replay(finished: Path, stepgap: Command) -> None:
    shutil.copytree(finished, "run")
    settings = Path("run/experiment.toml")
    settings.write_text(settings.read_text().replace("body_mass = 1.466", "body_mass = 1.5"))
    result = stepgap("report", "run")
    assert result.code == 0
    assert result.err.startswith("stepgap: missing in the report: replay (run/steps.csv: step 0 of")
    text = Path("run/report.html").read_text(encoding="utf-8")
    assert "There is no replay: run/steps.csv: step 0 of deployment 0 could not be reproduced exactly" in text
    assert "replay-data" not in text


@pytest.mark.usefixtures("no_figures")
def test_settings_that_are_not_valid_are_named(finished: Path, stepgap: Command) -> None:
    shutil.copytree(finished, "run")
    Path("run/experiment.toml").write_text("unheard_of = 1\n")
    result = stepgap("report", "run")
    assert result.code == 0
    assert result.err.startswith("stepgap: missing in the report: settings, gait and replay (the settings are not")
    text = Path("run/report.html").read_text(encoding="utf-8")
    for part in ("comparison with the default settings", "gait", "replay"):
        assert (
            f"There is no {part}: the settings are not valid in this version: run/experiment.toml: unheard_of" in text
        )


@pytest.mark.usefixtures("no_figures")
def test_a_run_with_settings_that_are_gone_is_reported(finished: Path, stepgap: Command) -> None:
    shutil.copytree(finished, "run")
    settings = Path("run/experiment.toml")
    settings.write_text(settings.read_text().replace("[learning]\n", '[learning]\nfeature_map = "identity"\n'))
    assert stepgap("report", "run") == CommandResult(0, "run/report.html\n", "")
    assert "learning.feature_map" in Path("run/report.html").read_text(encoding="utf-8")


def test_several_runs_are_compared_by_another_verb(finished: Path, stepgap: Command) -> None:
    refused(stepgap("report", finished, "other"), "compare several by: stepgap compare", "other")


def test_a_sweep_has_a_report(finished: Path, stepgap: Command) -> None:
    settings = combinations_of({"gap.delay": [0.001, 0.002], "learning.residual": ["gp", "linear"], "seed": [1, 2, 3]})
    write_results_table(Path("sweep"), settings, np.random.default_rng(0).uniform(0.01, 0.02, (12, 2, 2)))
    axes = {"gap.delay": [0.001, 0.002], "learning.residual": ["gp", "linear"]}
    Path("sweep/sweep.toml").write_text(tomli_w.dumps({"seeds": [1, 2, 3], "axes": axes}))
    shutil.copy(finished / "experiment.toml", "sweep")
    assert stepgap("report", "sweep") == CommandResult(0, "sweep/report.html\n", "")
    text = Path("sweep/report.html").read_text(encoding="utf-8")
    assert "All 12 cases of the sweep are finished" in text
    assert "last RMSE of speed [m/s]" in text
    assert '<tr><th scope="row">learning.iterations</th><td>1</td><td>4</td></tr>' in text
    Path("sweep/experiment.toml").write_text("unheard_of = 1\n")
    Path("sweep/sweep.toml").write_text("keep = 3\n")
    assert stepgap("report", "sweep").code == 0
    text = Path("sweep/report.html").read_text(encoding="utf-8")
    assert "without a valid sweep.toml the number of planned cases is not known" in text
    assert "last RMSE of speed</th>" in text
    before = contents(Path("sweep"))
    Path("sweep/results.csv").write_text("case\n")
    refused(stepgap("report", "sweep"), "sweep/results.csv, line 1: not the header of a sweep's results")
    Path("sweep/results.csv").unlink()
    refused(stepgap("report", "sweep"), "sweep/results.csv: no such file", "stepgap sweep --out sweep --resume")
    assert {name: content for name, content in before.items() if name != "results.csv"} == contents(Path("sweep"))


@pytest.mark.usefixtures("no_figures")
def test_a_damaged_model_is_left_out(finished: Path, stepgap: Command) -> None:
    shutil.copytree(finished, "run")
    whole = (finished / "models/iteration_1.json").read_bytes()
    for damage in (whole[: len(whole) // 2], b"\x89PNG\r\n\xff\xfe", b"[[["):
        Path("run/models/iteration_1.json").write_bytes(damage)
        result = stepgap("report", "run")
        assert (result.code, result.err.count("\n")) == (0, 1)
        assert result.err.startswith("stepgap: missing in the report: the learned model (run/models/iteration_1.json: ")
        assert "Traceback" not in result.err


@pytest.mark.usefixtures("no_figures")
@pytest.mark.parametrize("name", ["steps.csv", "summary.json", "experiment.toml"])
def test_damaged_files_are_refused_and_nothing_is_written(finished: Path, stepgap: Command, name: str) -> None:
    shutil.copytree(finished, "run")
    whole = (finished / name).read_bytes()
    for damage in (whole[: len(whole) // 2], b"\x89PNG\r\n\xff\xfe", b"[[["):
        (Path("run") / name).write_bytes(damage)
        before = contents(Path("run"))
        result = stepgap("report", "run")
        if result.code:  # half a TOML may be a whole one
            refused(result, Path(name).name)
            assert contents(Path("run")) == before
        else:
            assert name == "experiment.toml"
