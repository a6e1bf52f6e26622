"""Weights of the state that an experiment sets: they reach everything that uses the state or the nominal map."""

from pathlib import Path

import numpy as np
import pytest
import tomli_w

from stepgap.experiment.inputs import load_reference
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment, experiment_table, read_experiment, weighted_space
from stepgap.gym import robot_env
from stepgap.robots.entry_points import load_robot
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.nominal_maps.weighted_map import with_space
from stepgap.robots.robot import stairs
from stepgap.sweep.sweep_file import read_sweep
from tests.cli.command_line import Command, refused
from tests.control.maps import PitchingHopper
from tests.robots.plug_in import WEIGHTS_TOML

ROBOT = PitchingHopper()
SHORT = ("--learning.iterations", "1", "--learning.early_stop", "false", "--quiet")
CHANGED = ("--robot", "pitching", "--weights.height", "0", "--weights.pitch", "0.25")


def test_a_weighted_map_predicts_the_same_and_scales_errors_otherwise() -> None:
    space, rng = ROBOT.space, np.random.default_rng(0)
    affine = AffineMap(space, space.state_centre, space.command_centre, space.state_centre, rng.normal(size=(4, 6)))
    states, commands = rng.uniform(-0.1, 0.1, (5, 4)) + space.state_centre, rng.uniform(-5, 5, (5, 2))
    for step_map in (ROBOT, affine):
        found = with_space(step_map, weighted_space(space, {"pitch": 0.25, "height": 0}))
        assert found.space.error_scale == pytest.approx([0.2, np.inf, 0.8, np.inf])
        assert found.space.has_names_of(space)
        assert found(states, commands).tolist() == step_map(states, commands).tolist()
        assert found.jacobian(states, commands).tolist() == step_map.jacobian(states, commands).tolist()
        assert type(found) is AffineMap or step_map is ROBOT
    assert with_space(ROBOT, weighted_space(space, {})) is ROBOT


@pytest.mark.parametrize("kind", ["equations", "template"])
def test_they_reach_the_state_and_every_kind_of_nominal_map(package: Path, tmp_path: Path, kind: str) -> None:
    (tmp_path / "template.toml").write_text("[derivatives.speed]\nfx = 0.02\n[derivatives.height]\nfy = 0.003\n")
    table = {"nominal": {"kind": kind, "file": "template.toml"}} if kind == "template" else {}
    text = tomli_w.dumps({"robot": "pitching", "weights": {"height": 4, "pitch": 0.5}, **table})
    (tmp_path / "e.toml").write_text(text)
    settings = read_experiment(tmp_path / "e.toml")
    assert [each.weight for each in settings.space.state] == [1, 4, 0.5, 0]
    assert load_nominal(settings).map.space == settings.space
    again = read_experiment(tmp_path / "e.toml", [("weights.height", "0")])
    assert [each.weight for each in again.space.state] == [1, 0, 0.5, 0], "an option changes one weight of the file"
    assert experiment_table(again)["weights"] == {"height": 0.0, "pitch": 0.5}


def test_the_weights_of_the_page(tmp_path: Path) -> None:
    (tmp_path / "e.toml").write_text(WEIGHTS_TOML)
    assert [each.weight for each in read_experiment(tmp_path / "e.toml").space.state] == [1, 0.25]


def test_a_reference_of_the_robot_loses_the_targets_of_what_is_not_tracked() -> None:
    settings = Experiment(weights={"height": 0.0})
    reference, whole = (load_reference(each, each.space) for each in (settings, Experiment()))
    assert np.isnan(reference.targets[:, 1]).all()
    assert reference.targets[:, 0].tolist() == whole.targets[:, 0].tolist()


@pytest.mark.usefixtures("no_repeats")
def test_a_run_its_resume_its_report_and_its_controller_follow(
    package: Path, stepgap: Command, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stairs, "__defaults__", (4,))  # steps on each stair
    result = stepgap("run", *CHANGED, *SHORT, "--out", "out")
    assert result.code == 0, result.err
    run = Run("out")
    assert run.space.tracked.tolist() == [True, False, True, False]
    assert run.space == run.controller(1).step_controller.step_map.space
    targets = run.steps.target
    assert np.isnan(targets[:, 1:]).all(), "the stairs of the robot have targets of what the robot tracks"
    assert np.isfinite(targets[:, 0]).all()
    page = Path("out/report.html").read_text()
    assert ("<caption>Error of speed [" in page, "<caption>Error of height [" in page) == (True, False)
    whole = Path("out/steps.csv").read_bytes()
    Path("out/steps.csv").write_bytes(whole[: whole.rindex(b"\n1,9,") + 1])
    Path("out/summary.json").unlink()
    assert stepgap("run", "--resume", "--out", "out", "--quiet").code == 0
    assert Path("out/steps.csv").read_bytes() == whole
    refused(stepgap("gait", "--robot", "pitching", "--weights.pich", "1"), "the name of a state coordinate: speed, hei")
    Path("targets.csv").write_text("speed,yaw\n0.2,0.58\n")
    refused(stepgap("run", *CHANGED, "--reference", "targets.csv"), "header is 'speed,yaw'; it must be 'speed,height")


def test_a_weight_is_an_axis_of_a_sweep(package: Path, tmp_path: Path) -> None:
    (tmp_path / "s.toml").write_text("[axes]\n'weights.height' = [0, 0.5, 2]\n")
    sweep = read_sweep(tmp_path / "s.toml")
    assert [sweep.experiment(number).space.state[1].weight for number in range(3)] == [0, 0.5, 2]
    (tmp_path / "s.toml").write_text("[axes]\n'weights.height' = [0.5, -1]\n")
    with pytest.raises(ValueError, match=r"s\.toml: \[axes\] weights\.height = -1\.0, but it must be a finite number"):
        read_sweep(tmp_path / "s.toml")


def test_they_decide_the_reward_of_an_environment(package: Path) -> None:
    rewards = {}
    for weight in (0.0, 1.0, 4.0):
        env = robot_env(load_robot("pitching"), "model", noise=[0.0] * 4, weights={"height": weight})
        env.reset(seed=0)
        rewards[weight] = env.step(np.array([0.1, 0.4]))[1]
        env.close()
    height = rewards[0.0] - rewards[1.0]
    assert height > 0.01
    assert rewards[0.0] - rewards[4.0] == pytest.approx(4 * height)


def test_a_file_of_targets_loses_those_of_what_is_not_tracked(tmp_path: Path) -> None:
    """So the same file serves a run with fewer tracked coordinates, as a report proposes it."""
    (tmp_path / "targets.csv").write_text("speed,height\n0.2,0.58\n0.3,0.6\n")
    settings = Experiment(weights={"height": 0.0}, reference=str(tmp_path / "targets.csv"))
    reference = load_reference(settings, settings.space)
    assert reference.targets[:, 0].tolist() == [0.2, 0.3]
    assert np.isnan(reference.targets[:, 1]).all()
