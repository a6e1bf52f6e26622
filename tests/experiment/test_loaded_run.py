"""A loaded run gives the recorded commands and predictions again, and refuses what does not belong together."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from stepgap.base.errors import InputError
from stepgap.experiment.run import Run, load_run
from stepgap.robots.hopper.robot import Hopper
from tests.cli.command_line import Command

TARGETS = "speed,height\n0.1,0.56\n0.2,0.58\n0.2,0.58\n0.15,0.57\n0.25,0.59\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of two deployments, started from an earlier one."""
    from stepgap.cli.app import main
    from tests.quick_runs import leave_out_repeats, leave_out_report

    home = tmp_path_factory.mktemp("loaded")
    (home / "targets.csv").write_text(TARGETS)
    common = ["--reference", str(home / "targets.csv"), "--quiet"]
    with pytest.MonkeyPatch.context() as patch:
        leave_out_repeats(patch)
        leave_out_report(patch)
        main(["run", *common, "--out", str(home / "first"), "--iterations", "0", "--seed", "4"])
        more = ["--warm-start", str(home / "first"), "--iterations", "1", "--seed", "5", "--online"]
        main(["run", *common, "--out", str(home / "run"), *more, "--learning.early_stop", "false"])
    return home / "run"


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(folder, tmp_path / "copy"))


@pytest.mark.parametrize("iteration", [0, 1])
def test_the_controller_gives_the_recorded_commands_and_predictions(folder: Path, iteration: int) -> None:
    run = load_run(folder)
    assert run.steps.iterations == [0, 1]
    assert len(run.known) == 6  # with the hop of the start
    controller = run.controller(iteration)
    steps = run.steps.of_iteration(iteration)
    for logged in steps:
        plan = controller.plan(logged.record.state, logged.target, steps.target[logged.step :])
        np.testing.assert_allclose(plan.command, logged.record.command, rtol=0, atol=1e-9)
        np.testing.assert_allclose(plan.predicted, logged.predicted, rtol=0, atol=1e-9)
        np.testing.assert_allclose(plan.std, logged.std, rtol=0, atol=1e-9)
        controller = controller.after(logged)


def test_the_next_deployment_knows_all_steps(folder: Path) -> None:
    run = load_run(str(folder))
    learner, corrected = run.learner(), run.corrected()
    assert (learner.iteration, len(learner.known)) == (2, 18)
    state, command = [0.2, 0.58], [0.0, 0.0]
    point = np.array([*state, *command])
    expected = run.needed(run.nominal)(state, command) + learner.learned.mean(point)
    np.testing.assert_allclose(corrected(state, command), expected, atol=1e-12)
    for wrong in (-1, 3):
        with pytest.raises(InputError, match=f"has no deployment {wrong}; it may be 0 to 2"):
            run.controller(wrong)


def test_another_nominal_map_is_refused(copy: Path) -> None:
    path = copy / "experiment.toml"
    text = path.read_text()
    mass = Hopper().parameters.body_mass
    path.write_text(text.replace(f"body_mass = {mass}\n", f"body_mass = {1.0001 * mass}\n"))
    assert path.read_text() != text
    step, before = "at speed [^ ]+, height [^ ]+, fx [^ ]+, fy [^ ]+", r"(speed|height) was [\d.e-]+ m"
    difference = rf"{step} its next {before}(/s)?, that of this map is [\d.e-]+ m(/s)?; they may differ by [\d.e-]+ m"
    message = rf"iteration_1\.json: was learned on another nominal map: {difference}"
    with pytest.raises(InputError, match=message):
        load_run(copy).controller(1)


def test_missing_and_foreign_files_are_named(copy: Path, tmp_path: Path) -> None:
    model = copy / "models" / "iteration_1.json"
    data = json.loads(model.read_text())
    assert (data["schema"], data["state"]) == (1, [["speed", "m/s"], ["height", "m"]])
    for key, value, message in (
        ("nominal_steps", [[1.0]], "was learned on another nominal map"),
        ("nominal_steps", "x", "has no steps of its nominal map"),
        ("kind", "unknown_kind", "not a residual"),
    ):
        model.write_text(json.dumps({**data, key: value}))
        with pytest.raises(InputError, match=rf"iteration_1\.json: {message}"):
            load_run(copy).corrected(1)
    model.unlink()
    with pytest.raises(InputError, match=r"there is no models/iteration_1\.json"):
        load_run(copy).corrected(1)
    (copy / "steps.csv").write_text("a,b\n")
    with pytest.raises(InputError, match=r"steps\.csv.*must be the folder of a run"):
        load_run(copy)
    with pytest.raises(InputError, match=r"experiment\.toml"):
        load_run(tmp_path / "nothing")


@pytest.mark.usefixtures("no_repeats", "no_report")
def test_any_robot_is_loaded(stepgap: Command) -> None:
    Path("targets.csv").write_text("speed,height\n" + "0.5,0.415\n" * 6 + "0.55,0.42\n" * 6)
    command = ("run", "--robot", "quadruped", "--reference", "targets.csv", "--out", "out", "--iterations", "1")
    result = stepgap(*command, "--quiet", "--seed", "3")
    assert result.code == 0, result.err
    run = load_run("out")
    controller = run.controller(1)
    logged = next(iter(run.steps.of_iteration(1)))
    plan = controller.plan(logged.record.state, logged.target)
    np.testing.assert_allclose(plan.command, logged.record.command, rtol=0, atol=1e-9)


def test_a_run_shows_itself_in_a_notebook(folder: Path, tmp_path: Path) -> None:
    run = load_run(folder)
    for part in (run, run.final, run.nominal, run.corrected(), run.learner(), run.deployments[0], run.steps):
        assert "\n" not in repr(part)
        assert len(repr(part)) < 300
    assert f"{len(run.recorded)} steps" in repr(run)
    assert "RMSE of deployment 1" in run._repr_html_()
    picture = run.plot()._repr_png_()  # pyright: ignore[reportAttributeAccessIssue]
    assert picture.startswith(b"\x89PNG")
    with pytest.raises(InputError, match=r"figure 'commandos': this run has .*did you mean 'commands'"):
        run.figure("commandos")
    empty = Run(tmp_path)
    assert "not readable" in repr(empty)
    assert "not readable" in empty._repr_html_()
