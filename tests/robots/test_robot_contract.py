"""Every robot has every verb: the built-in ones, the ball of docs/own_robot.md, and one that is tracked in part."""

import json
import shutil
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any, cast

import gymnasium
import numpy as np
import pytest

import stepgap.gym
from stepgap.base.errors import InputError
from stepgap.cli.app import main
from stepgap.experiment.inputs import load_reference, write_experiment
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, experiment_table, read_experiment
from stepgap.learning.steps import Steps
from stepgap.robots.entry_points import load_robot, robot_names
from stepgap.robots.robot import Robot, Simulation
from stepgap.step import StepMap, StepRecord, StepStatus
from stepgap.view.source import Source
from tests.cli.command_line import Command, refused
from tests.quick_runs import compute_in_a_thread, leave_out_repeats, leave_out_report, leave_out_sweep_report
from tests.robots.plug_in import CUSTOM_TOML, TEMPLATE_TOML

ROBOTS = ("hopper", "quadruped", "monopod", "velocity", "ball", "pitching")
SHORT = ("--learning.iterations", "1", "--learning.early_stop", "false", "--quiet")


@pytest.fixture(params=ROBOTS)
def robot(request: pytest.FixtureRequest, package: Path) -> Robot:
    return load_robot(request.param)


@pytest.fixture
def run(stepgap: Command, robot: Robot) -> Callable[..., Path]:
    """Runs an experiment of four steps a deployment, and returns its folder."""
    write_targets(robot, Path("targets.csv"), repeats=1)

    def made(*options: str) -> Path:
        result = stepgap("run", "--robot", robot.name, "--reference", "targets.csv", "--out", "out", *SHORT, *options)
        assert result.code == 0, result.err
        return Path("out")

    return made


def write_targets(robot: Robot, path: Path, repeats: int = 3) -> None:
    """Writes a reference of four targets near the centre of the robot's states, all of them held for some steps."""
    space = robot.space
    shares = [share for share in (-1, 1, 0, -0.5) for _ in range(repeats)]
    rows = [space.state_centre + 0.2 * share * space.state_scale for share in shares]
    tracked = np.flatnonzero(space.tracked)
    lines = [",".join(space.state_names[row] for row in tracked), *(",".join(map(str, row[tracked])) for row in rows)]
    path.write_text("\n".join(lines) + "\n")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Robot], Path]:
    """Returns the folder of a finished run of a robot, without a report; it is made once."""
    parent = tmp_path_factory.mktemp("runs")

    def finished(robot: Robot) -> Path:
        folder, targets = parent / robot.name, parent / f"{robot.name}.csv"
        if not folder.exists():
            write_targets(robot, targets)
            with pytest.MonkeyPatch.context() as patch:
                leave_out_repeats(patch)
                leave_out_report(patch)
                main(["run", "--robot", robot.name, "--reference", str(targets), "--out", str(folder), *SHORT])
        return folder

    return finished


def test_its_settings_are_tables_that_are_written_and_read_back(robot: Robot, tmp_path: Path) -> None:
    settings = Experiment(robot)
    write_experiment(tmp_path, settings, load_reference(settings, robot.space))
    assert read_experiment(tmp_path / "experiment.toml") == settings
    table = experiment_table(settings)
    assert table["robot"] == robot.name
    for field in fields(cast("Any", robot)):
        assert table[field.name].keys() == {inner.name for inner in fields(getattr(robot, field.name))}
    assert robot.name in robot_names()


def test_its_published_result_is_of_its_state(robot: Robot) -> None:
    if published := robot.published():
        assert published.reference.of(robot.space) is published.reference
        shapes = {errors.shape for by_measure in published.errors.values() for errors in by_measure.values()}
        assert shapes == {robot.space.state_centre.shape}


def test_its_maps_fit_its_space_and_track_its_references(robot: Robot) -> None:
    space = robot.space
    for make in robot.nominal_maps().values():
        outcome = make().evaluate(space.state_centre, space.command_centre)
        assert outcome.next_state.shape == space.state_centre.shape
        assert outcome.status == StepStatus.OK
    for make in robot.references().values():
        assert len(make().of(space))


def test_its_simulations_repeat_themselves_and_differ_from_the_model(robot: Robot) -> None:
    nominal = load_nominal(Experiment(robot)).map
    for name, make in robot.simulations().items():
        if name == "emulated-ring":
            continue  # it needs raw sockets; tests/experiment/test_plants.py
        first, second = (_one_step(make(np.random.default_rng(1))) for _ in range(2))
        assert first.next_state.tolist() == second.next_state.tolist()
        predicted = nominal(first.state, first.requested)
        assert (np.abs(first.next_state - predicted) > 1e-4).any()


def _one_step(simulation: Simulation) -> StepRecord:
    with simulation.plant(np.random.default_rng(2)) as plant:
        plant.start()
        return plant.take_step(plant.space.command_centre)


@pytest.mark.usefixtures("no_repeats", "made_figures")
def test_run_report_resume_export_fit_and_view(
    robot: Robot, runs: Callable[[Robot], Path], stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = Path(shutil.copytree(runs(robot), "out"))
    summary = json.loads((folder / "summary.json").read_text())
    before, after = (
        np.array(list(entry["rmse"].values()), float)[robot.space.tracked] for entry in summary["iterations"]
    )
    scale = robot.space.state_scale[robot.space.tracked]
    assert np.linalg.norm(after / scale) < 0.85 * np.linalg.norm(before / scale)
    whole = (folder / "steps.csv").read_bytes()
    (folder / "steps.csv").write_bytes(whole[: whole.rindex(b"\n1,9,") + 1])
    (folder / "summary.json").unlink()
    with monkeypatch.context() as patch:
        leave_out_report(patch)
        result = stepgap("run", "--resume", "--out", folder, "--quiet")
    assert (result.code, (folder / "steps.csv").read_bytes() == whole) == (0, True), result.err
    for verb in (["report", folder], ["export", folder, "--to", "csv"], ["fit", folder]):
        result = stepgap(*verb)
        assert result.code == 0, result.err
    page = (folder / "report.html").read_text()
    assert "could be drawn" not in page
    for quantity in robot.space.state:
        assert (f"<caption>Error of {quantity.name} [{quantity.unit}]" in page) == (quantity.weight > 0)
    source = Source(folder)
    assert source.iterations == [0, 1]


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_warm_start_online_and_exploration(
    robot: Robot, run: Callable[..., Path], runs: Callable[[Robot], Path]
) -> None:
    folder = run("--warm-start", str(runs(robot)), "--online", "--explore", "3", "--iterations", "0")
    assert (folder / "warm_start.csv").is_file()
    assert read_experiment(folder / "experiment.toml").robot == robot


def template_of(nominal: StepMap) -> str:
    """A template with the derivatives of a map in the middle of the ranges of use, to one digit."""
    space = nominal.space
    text = ""
    for name, row in zip(space.state_names, nominal.jacobian(space.state_centre, space.command_centre), strict=True):
        text += f"[derivatives.{name}]\n"
        text += "".join(f"{key} = {value:.1g}\n" for key, value in zip(space.names, row, strict=True))
    return text


def test_any_robot_has_a_template_or_a_log_as_nominal_map(
    robot: Robot, runs: Callable[[Robot], Path], tmp_path: Path
) -> None:
    template = tmp_path / "map.toml"
    template.write_text(template_of(load_nominal(Experiment(robot)).map))
    for kind, file in (("template", template), ("log", runs(robot) / "steps.csv")):
        options = [("robot", robot.name), ("nominal.kind", kind), ("nominal.file", str(file))]
        found = load_nominal(read_experiment(None, options)).map
        assert found.space == robot.space
        assert found.evaluate(robot.space.state_centre, robot.space.command_centre).status == StepStatus.OK


@pytest.mark.parametrize("robot", ["ball"], indirect=True)
@pytest.mark.usefixtures("no_repeats", "no_report")
def test_the_folder_of_a_run_with_a_file_as_nominal_map_is_complete(
    robot: Robot, run: Callable[..., Path], stepgap: Command
) -> None:
    Path("map.toml").write_text(TEMPLATE_TOML)
    folder = run("--nominal.kind", "template", "--nominal.file", "map.toml")
    Path("map.toml").unlink()
    settings = read_experiment(folder / "experiment.toml")
    assert settings.nominal.kind == "template"
    assert load_nominal(settings).map.space == robot.space
    assert stepgap("report", folder).code == 0


def test_gait_and_a_step(robot: Robot, package: Path, stepgap: Command) -> None:
    Path("e.toml").write_text(f"robot = '{robot.name}'\n")
    command = f"{robot.space.command_names[0]}={robot.space.command_centre[0]}"
    for verb in (["gait", "--robot", robot.name], ["gait", "e.toml", "--command", command]):
        result = stepgap(*verb)
        assert result.code == 0, result.err
        assert robot.space.state_names[0] in result.out


@pytest.mark.usefixtures("no_repeats")
def test_check(robot: Robot, stepgap: Command, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = robot.name in ("ball", "pitching")  # those of one state, and of more states than commands
    if not drawn:
        monkeypatch.setattr("stepgap.report.drawing.write_picture", lambda path, make: None)
    result = stepgap("check", robot.name)
    assert result.code == 0, result
    assert not drawn or Path("check.png").read_bytes().startswith(b"\x89PNG")
    assert "wrong" not in {line[10:20].strip() for line in result.out.splitlines()}


def test_sweep(
    robot: Robot,
    run: Callable[..., Path],
    stepgap: Command,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    leave_out_sweep_report(monkeypatch)
    if robot.name != "ball":  # that of another package is found in other processes, too
        compute_in_a_thread(monkeypatch)
    Path("e.toml").write_text(f"robot = '{robot.name}'\nreference = 'targets.csv'\n[learning]\niterations = 1\n")
    Path("sweep.toml").write_text("base = 'e.toml'\nseeds = [1]\n[axes]\n'learning.residual' = ['linear']\n")
    result = stepgap("sweep", "sweep.toml", "--out", "sweep", "--quiet", "--processes", "1")
    assert result.code == 0, result.err
    assert (Path("sweep") / "results.csv").read_text().count("\n") == 3


def test_gymnasium(robot: Robot) -> None:
    for plant in ("", "model"):
        env = gymnasium.make(stepgap.gym.STEP_ID, robot=robot.name, plant=plant)
        observation, _ = env.reset(seed=1)
        assert observation.shape == (2 * len(robot.space.state),)
        _, reward, _, _, info = env.step(np.zeros(len(robot.space.command), np.float32))
        assert float(reward) <= 0
        assert info["status"] == "ok"
        env.close()


def test_the_template_of_the_page(package: Path, tmp_path: Path) -> None:
    (tmp_path / "template.toml").write_text(TEMPLATE_TOML)
    changes = [("robot", "ball"), ("nominal.kind", "template"), ("nominal.file", str(tmp_path / "template.toml"))]
    found = load_nominal(read_experiment(None, changes)).map
    np.testing.assert_allclose(found([0.6], [0.35]), [0.58])


def test_the_settings_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "experiment.toml").write_text(CUSTOM_TOML)
    (tmp_path / "template.toml").write_text(TEMPLATE_TOML)
    settings = read_experiment(tmp_path / "experiment.toml")
    assert settings.robot.space.state_names == ("height",)
    np.testing.assert_allclose(load_nominal(settings).map([0.6], [0.35]), [0.58])
    write_experiment(tmp_path, settings, load_reference(settings, settings.robot.space))
    assert read_experiment(tmp_path / "experiment.toml").robot == settings.robot


WRONG_CUSTOM = {
    "": "[quantities] state = 0, but it must be at least one [[quantities.state]] with name, unit, lower, upper",
    "[[quantities.state]]\nname = 'x'\nunit = 'm'\nlower = 0": "upper: missing; it must be given",
    "[[quantities.state]]\nname = 'x'\nunit = 'm'\nlower = 1\nupper = 0": "[quantities.state 1] upper = 0.0, but it "
    "must be finite and exceed lower = 1 (x)",
    "[[quantities.state]]\nname = 'x y'\nunit = 'm'\nlower = 0\nupper = 1": "[quantities.state 1] name = 'x y', but it "
    "must consist of letters",
    "[[quantities.state]]\nname = 'x'\nunit = 'm'\nlower = 0\nupper = 1\n"
    "[[quantities.command]]\nname = 'x'\nunit = 'm'\nlower = 0\nupper = 1": "but it must have different names",
    "quantities = 3": "quantities = 3, but it must be a table",
}


@pytest.mark.parametrize("text", WRONG_CUSTOM)
def test_a_wrong_description_is_refused_with_the_rule(tmp_path: Path, text: str) -> None:
    path = tmp_path / "e.toml"
    path.write_text(f"robot = 'custom'\n{text}\n")
    with pytest.raises(InputError) as caught:
        read_experiment(path)
    assert str(path) in str(caught.value)
    assert WRONG_CUSTOM[text] in str(caught.value)


WRONG_TEMPLATES = {
    "[derivatives.hight]\nheight = 1": "[derivatives] hight: unknown key; did you mean height?",
    "[derivatives.height]\nspeed = 1": "[derivatives] height.speed: unknown key; the keys here are height, paddle",
    "[derivatives.height]\npaddle = 'x'": "height.paddle = 'x', but it must be a finite number",
    "[derivatives.height]\npaddle = nan": "height.paddle = nan, but it must be a finite number",
    "[derivatives.height]\nheight = 1": "[derivatives]: none by a command",
    "step = 3": "step = 3, but it must be a table",
    "[step]\nnext_stat = {}": "[step] next_stat: unknown key; did you mean next_state?",
    "x = ": "not TOML",
}


@pytest.mark.parametrize("text", WRONG_TEMPLATES)
def test_a_wrong_template_is_refused_with_the_rule(package: Path, tmp_path: Path, text: str) -> None:
    path = tmp_path / "wrong.toml"
    path.write_text(text)
    settings = read_experiment(None, [("robot", "ball"), ("nominal.kind", "template"), ("nominal.file", str(path))])
    with pytest.raises(InputError) as caught:
        load_nominal(settings)
    assert str(path) in str(caught.value)
    assert WRONG_TEMPLATES[text] in str(caught.value)


def test_a_template_without_a_derivative_by_a_command_is_warned_of(stepgap: Command) -> None:
    Path("t.toml").write_text("[derivatives.speed]\nspeed = 0.5\nfx = 0.01\n\n[derivatives.height]\nheight = 0.6\n")
    result = stepgap("gait", "--nominal.kind", "template", "--nominal.file", "t.toml", "--state", "height=0.6")
    assert result.err.startswith("stepgap: t.toml: [derivatives.height] has none by a command, so no command changes ")
    assert "give a rough derivative by fx or fy" in result.err
    assert "[derivatives.speed]" not in result.err


@pytest.mark.parametrize(
    ("options", "parts"),
    [
        (["--robot", "bal"], ["robot 'bal': unknown; did you mean ball?", "hopper"]),
        (["--robot", "ball", "--gains.stiffness", "3"], ["--gains: unknown key; the keys here are seed"]),
        (["--robot", "ball", "--ball.restitution", "2"], ["--ball.restitution = 2.0, but it must lie between 0 and 1"]),
        (
            ["--robot", "ball", "--plant", "twin"],
            ["--plant twin: unknown; it must be one of dragged, worn, driver, process"],
        ),
        (["--robot", "ball", "--nominal.kind", "simulator"], ["robot 'ball' has no such map", "equations, template"]),
        (["--robot", "ball", "--nominal.kind", "log"], ["give its file by nominal.file, such as steps.csv"]),
        (["--robot", "ball", "--nominal.kind", "log", "--nominal.file", "x.csv"], ["x.csv: No such file"]),
        (["hopper.toml", "--robot", "ball"], ["--robot ball: hopper.toml is an experiment of robot = 'hopper'"]),
        (["ball.toml", "--seed", "-1"], ["--seed = -1"]),
    ],
)
def test_wrong_options_are_named(stepgap: Command, package: Path, options: list[str], parts: list[str]) -> None:
    Path("hopper.toml").write_text("robot = 'hopper'\n")
    Path("ball.toml").write_text("robot = 'ball'\n[gap]\ndrag = 0.1\n")
    refused(stepgap("run", *options, "--out", "out"), *parts)
    assert not Path("out").exists()


def test_a_log_of_too_few_steps_is_refused(package: Path, tmp_path: Path) -> None:
    from stepgap.records.steps_csv import text_of

    robot = load_robot("ball")
    (tmp_path / "steps.csv").write_text(text_of(Steps(robot.space)))
    settings = read_experiment(
        None, [("robot", "ball"), ("nominal.kind", "log"), ("nominal.file", str(tmp_path / "steps.csv"))]
    )
    with pytest.raises(InputError, match="0 completed steps, but a map needs at least 4"):
        load_nominal(settings)


@pytest.mark.parametrize("robot", ["pitching"], indirect=True)
def test_what_of_a_controller_that_does_not_track_everything_is_exported_is_said(
    robot: Robot, runs: Callable[[Robot], Path], tmp_path: Path, stepgap: Command
) -> None:
    result = stepgap("export", runs(robot), "--to", "c", "--out", tmp_path / "controller.c")
    assert result.code == 0
    assert "later steps" in result.out + result.err
    result = stepgap("fit", runs(robot), "--nominal", "target")
    assert result.code == 2
    assert "--nominal target: the log has no step with one for every state coordinate" in result.err
