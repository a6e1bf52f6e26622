"""The causes on the first screen: each planted one is named with its remedy, and no other one."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.summary import WarmStart
from stepgap.report.page import run_summary
from stepgap.report.reasons import changes_at_constant_targets, reasons
from tests.control.maps import LossyHopper

NOMINAL = LossyHopper()
NOISE = np.array([0.004, 0.0012])
NAMES = ("speed", "height")
HELD = Reference.from_segments(NAMES, [(1, (0.1, 0.56)), (16, (0.2, 0.58))], 30)


def run_of(folder: Path, real: LossyHopper, reference: Reference = HELD, iterations: int = 1) -> Run:
    """A run on a robot that differs from the map, with its folder."""
    folder.mkdir()
    plant = partial(ModelPlant, real, np.array([0.1, 0.56]), NOISE)
    learning = LearningSettings("posterior", iterations, tolerance=0.0, early_stop=False)
    run_experiment(Setup(NOMINAL, Plants(plant), reference, learning), folder)
    return Run(folder, space=NOMINAL.space, nominal=NOMINAL)


@pytest.fixture(scope="module")
def tracked(tmp_path_factory: pytest.TempPathFactory) -> Run:
    return run_of(tmp_path_factory.mktemp("causes") / "run", LossyHopper(mass=1.75, drift=0.08))


def changed(run: Run, steps: Steps, factor: float) -> Run:
    """The run with other steps, and errors that are larger by a factor."""
    summary = run.summary
    *before, last = summary.deployments
    larger = replace(last, rmse=factor * last.rmse)
    return Run(
        run.folder,
        space=run.space,
        nominal=NOMINAL,
        recorded=steps,
        summary=replace(summary, deployments=(*before, larger)),
    )


def test_a_robot_that_tracks_with_calm_commands_has_no_cause(tracked: Run) -> None:
    assert reasons(tracked) == []
    assert "Why, and what next" not in run_summary(tracked)


def test_commands_that_jump_are_named_even_where_the_robot_tracks(tracked: Run) -> None:
    steps = tracked.recorded
    signs = np.where(steps.number % 2, 0.4, -0.4)[:, None]
    jumping = steps.with_columns(requested=NOMINAL.space.command_centre + signs * NOMINAL.space.command_scale)
    np.testing.assert_allclose(changes_at_constant_targets(jumping), 0.4)
    (reason,) = reasons(changed(tracked, jumping, 1.0))
    assert "changes by 40 % of its range or more in every fourth step" in reason.sentence
    assert reason.command.endswith("/run/experiment.toml --control.largest_change 0.1")


def test_targets_beyond_what_the_commands_can_do(tmp_path: Path) -> None:
    high = Reference.from_segments(NAMES, [(1, (0.1, 0.56)), (8, (0.2, 1.2))], 30)
    run = run_of(tmp_path / "run", NOMINAL, high)
    first = reasons(run)[0]
    assert first.sentence == "By what was learned, no command holds 1 of 2 targets."
    assert first.advice.startswith("Track speed alone, to see whether height is what asks too much")
    assert first.command.endswith("--weights.height 0")
    assert first.command in run_summary(run)


def test_changes_that_one_step_cannot_make(tmp_path: Path) -> None:
    up = Reference.from_segments(NAMES, [(1, (0.1, 0.54)), (11, (0.1, 0.75)), (21, (0.1, 0.54))], 30)
    (reason,) = reasons(run_of(tmp_path / "run", NOMINAL, up))
    assert reason.sentence == "The errors of height are mostly those of the 4 steps after a change of the target."
    assert reason.command.endswith("--control.horizon 4")


def test_steps_of_another_robot_known_before_the_run(tracked: Run) -> None:
    steps = tracked.recorded
    off = steps.with_columns(predicted=steps.next_state + 0.5 * NOMINAL.space.state_scale)
    before = replace(tracked.summary, warm_start=WarmStart(227, "0" * 64))
    run = Run(tracked.folder, space=tracked.space, nominal=NOMINAL, recorded=off, summary=before)
    assert not reasons(run), "it tracked nevertheless"
    far = replace(before, deployments=tuple(replace(each, rmse=50 * each.rmse) for each in before.deployments))
    first = reasons(Run(tracked.folder, space=tracked.space, nominal=NOMINAL, recorded=off, summary=far))[0]
    assert "times worse than the nominal map: they are of another robot" in first.sentence
    assert first.command.endswith("/run/experiment.toml --warm-start none")


def test_a_robot_of_which_nothing_was_learned(tmp_path: Path) -> None:
    run = run_of(tmp_path / "run", LossyHopper(mass=2.3, drift=0.15), iterations=0)
    last = reasons(run)[-1]
    assert last.sentence == "Nothing was learned yet."
    assert last.command == f"stepgap run --out {run.folder} --extend 2"


def test_what_made_it_worse_stands_alone(tracked: Run) -> None:
    before, last = tracked.summary.deployments
    worse = replace(last, rmse=10 * before.rmse)
    run = Run(
        tracked.folder,
        space=tracked.space,
        nominal=NOMINAL,
        recorded=tracked.recorded,
        summary=replace(tracked.summary, deployments=(before, worse)),
    )
    (reason,) = reasons(run)
    assert reason.sentence.startswith("Deployment 0 made all its 30 steps with the nominal map, and what was learned")


def test_drives_that_are_too_weak_hide_other_causes(tracked: Run) -> None:
    steps = tracked.recorded
    low = steps.with_columns(next_state=np.tile([0.05, 0.5], (len(steps), 1)))
    *before, last = tracked.summary.deployments
    weak = replace(last, rmse=50 * last.rmse, cut=last.steps)
    run = Run(
        tracked.folder,
        space=tracked.space,
        nominal=NOMINAL,
        recorded=low,
        summary=replace(tracked.summary, deployments=(*before, weak)),
    )
    (reason,) = reasons(run)
    assert reason.sentence.startswith("Limits of the drives cut 30 of 30 commands of the last deployment. In all")
    assert reason.command.endswith("--target speed=0.05,height=0.5")


def test_bounds_of_a_setting_are_proposed_wider(tracked: Run) -> None:
    steps = tracked.recorded
    at_bound = steps.with_columns(requested=np.tile([30.0, 0.0], (len(steps), 1)))
    far = replace(tracked.summary, deployments=tuple(replace(one, rmse=20 * one.rmse) for one in tracked.deployments))
    run = Run(tracked.folder, nominal=NOMINAL, recorded=at_bound, summary=far, settings=Experiment())
    (reason, *_) = reasons(run)
    assert reason.sentence.startswith("fx was at a bound in 100 %")
    assert reason.command.endswith("/run/experiment.toml --command.fx_lower=-60 --command.fx_upper=60")


def test_jumps_that_learning_brought_are_named_where_the_noise_floor_grew_with_them(tracked: Run) -> None:
    """A command that acts in the next step, too, rings; then the floor that is found from these steps is no measure."""
    steps = tracked.recorded
    signs = np.where(steps.number % 2, 0.4, -0.4)[:, None]
    ringing = steps.with_columns(requested=NOMINAL.space.command_centre + signs * NOMINAL.space.command_scale)
    run = changed(tracked, ringing, 100.0)
    assert not run.summary.noise_floor_measured
    (reason,) = reasons(run)
    assert reason.command.endswith("--control.largest_change 0.1")
    assert "It tracked" not in run_summary(run)
