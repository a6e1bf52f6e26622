"""Context: what a robot declares in one line is recorded, learned from, reported and exported by its name."""

import json
import shutil
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import Walk, walks
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.recovery import recover_file
from stepgap.records.step_columns import step_columns
from stepgap.records.steps_csv import StepWriter, digest, read_step_log, space_of_header, with_context
from stepgap.step import Array, ContextQuantity, StepMap, StepRecord, StepSpace
from tests.control.maps import YAW, LossyHopper

TRACK = ContextQuantity("track", "m", period=8.0)
GROUND = ContextQuantity("ground", "m")
LEARNING = LearningSettings(iterations=1, early_stop=False)
TARGETS = Reference(("speed", "height"), np.tile([[0.2, 0.58], [0.15, 0.56], [0.25, 0.6]], (20, 1)))


@dataclass(frozen=True)
class Walker(LossyHopper):
    """A hopper with other context than the built-in one."""

    context: tuple[ContextQuantity, ...] = (TRACK, GROUND)

    @property
    def space(self) -> StepSpace:
        return replace(super().space, context=self.context)


class RoundTrack(ModelPlant):
    """Goes 0.9 m along a track of 8 m in each step; its ground is uneven, which is measured, too."""

    def __init__(self, walker: Walker, rng: np.random.Generator):
        reality = replace(walker, loss=0.45)
        super().__init__(reality, np.array([0.2, 0.58]), np.array([2e-3, 5e-4]), rng)
        self._way = 0.0

    def take_step(self, command: Array) -> StepRecord:
        record, ground = super().take_step(command), 0.02 * np.sin(self._way * 2 * np.pi / 8.0)
        self._way += 0.9
        self._state = record.next_state + np.array([ground, 0.0])
        values = {"track": self._way, "ground": ground, "yaw": self._way * 2 * np.pi / 8.0}
        context = {name: values[name] for name in self.space.context_names}
        return replace(record, next_state=self._state, context=context)


def ran(folder: Path, walker: Walker, targets: Reference = TARGETS) -> Path:
    folder.mkdir(exist_ok=True)
    run_experiment(Setup(walker, Plants(lambda rng: RoundTrack(walker, rng)), targets, LEARNING, seed=1), folder)
    return folder


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a robot that measures its way along the track."""
    return ran(tmp_path_factory.mktemp("run"), Walker())


@pytest.fixture(scope="module")
def run_with_yaw(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same with an angle about the vertical instead of the way."""
    return ran(tmp_path_factory.mktemp("yaw"), Walker(context=(YAW,)))


def test_each_quantity_has_a_column_with_its_unit(run: Path) -> None:
    steps = Run(run, space=Walker().space).steps
    columns = {column.name: column for column in step_columns(steps, 0)}
    assert [*columns][-3:] == ["track_after", "ground_after", "status"]
    assert columns["track_after"].unit == columns["ground_after"].unit == "m"
    np.testing.assert_allclose(columns["track_after"].values, 0.9 * np.arange(1, 61))
    assert space_of_header(run / "steps.csv").context_names == ("track", "ground")


def test_the_phase_is_that_of_the_periodic_quantity(run: Path) -> None:
    steps = read_step_log(run / "steps.csv", Walker().space)
    np.testing.assert_allclose(steps.of_iteration(1).phase[1:], 2 * np.pi * 0.9 / 8 * np.arange(1, 60))
    learner = Learner.start(Walker(), steps, LEARNING, 1)
    assert learner.phase == pytest.approx(2 * np.pi * 0.9 * 60 / 8)


def rmse_of_speed(folder: Path) -> float:
    """That of the redeployment."""
    return json.loads((folder / "summary.json").read_text())["iterations"][1]["rmse"]["speed"]


def test_only_the_phase_matters_not_how_it_is_measured(run: Path, run_with_yaw: Path, tmp_path: Path) -> None:
    """A track of 8 m, and an angle about the vertical, give the same deployments; without a period it is noise."""
    without_phase = ran(tmp_path, Walker(context=(GROUND,)))
    assert rmse_of_speed(run) == pytest.approx(rmse_of_speed(run_with_yaw), rel=1e-6)
    assert rmse_of_speed(run) < 0.7 * rmse_of_speed(without_phase)


def test_a_second_periodic_quantity_is_refused() -> None:
    with pytest.raises(ValueError, match="must have at most one quantity with a period"):
        _ = Walker(context=(TRACK, YAW)).space


class Discharging(ModelPlant):
    """A walking robot that drifts at a low voltage of its battery, which goes up and down."""

    def __init__(self, nominal: StepMap, rng: np.random.Generator):
        super().__init__(nominal, np.zeros(3), np.full(3, 5e-3), rng)
        self._number = 0

    def take_step(self, command: Array) -> StepRecord:
        voltage = -1.0 if self._number // 10 % 2 else 0.0
        self._number += 1
        record = super().take_step(command)
        self._state = record.next_state + voltage * np.array([0.2, 0.1, -0.2])
        context = {"battery": voltage} if self.space.context_inputs else {}
        return replace(record, next_state=self._state, context=context)


def test_a_number_of_its_own_is_an_input_of_what_a_walking_robot_learns(tmp_path: Path) -> None:
    battery = ContextQuantity("battery", "V", input_scale=1.0)
    errors = list[float]()
    for name, context in {"with": (battery,), "without": ()}.items():
        robot = TrottingRobot(walk=Walk(context=context))
        nominal = robot.nominal_maps()["lag"]()
        plants = Plants(partial(Discharging, nominal))
        folder = tmp_path / name
        folder.mkdir()
        run_experiment(Setup(nominal, plants, walks(robot.space, 3), LEARNING, seed=1), folder)
        steps = read_step_log(folder / "steps.csv", robot.space).of_iteration(1)
        foreseen = np.arange(len(steps)) % 10 > 0  # the voltage of the step before was that of the step
        scaled = steps.tracking_errors()[foreseen] / robot.space.state_scale
        errors.append(float(np.sqrt(np.mean(scaled**2))))
    assert errors[0] < 0.7 * errors[1]


def test_what_is_measured_besides_has_a_name_of_its_own_and_is_not_simulated() -> None:
    with pytest.raises(ValueError, match=r"context.*have names that nothing else"):
        Walk(context=(ContextQuantity("heading", "rad"),))
    robot = TrottingRobot(walk=Walk(context=(ContextQuantity("battery", "V", input_scale=1.0),)))
    plant = MjcfPlant(robot, np.random.default_rng(0))
    plant.start()
    assert np.isnan(plant.take_step(np.zeros(3)).context["battery"])


# Files of versions in which every robot had the column yaw_after


@pytest.fixture
def old(run_with_yaw: Path, tmp_path: Path) -> Path:
    """A run of a robot that declares no context, in which a yaw was recorded."""
    return Path(shutil.copytree(run_with_yaw, tmp_path / "old"))


def test_an_old_run_is_read_by_a_robot_without_context(old: Path, tmp_path: Path) -> None:
    bare = Walker(context=()).space
    steps = read_step_log(old / "steps.csv", bare)
    assert steps.space.context_names == ("yaw",)
    assert np.isfinite(steps.context).all()
    assert np.isnan(steps.phase).all(), "the robot does not say that it has a period"
    for space in (None, bare, Walker().space):
        record = Run(old, space=space) if space else Run(old)
        assert len(record.steps) == 120
        assert digest(record.steps) == record.summary.steps_sha256
    recover_file(old, tmp_path / "recovered")
    assert (tmp_path / "recovered" / "steps.csv").read_bytes() == (old / "steps.csv").read_bytes()


def test_an_old_run_is_continued_with_the_columns_that_it_has(tmp_path: Path) -> None:
    """The robot that recorded a column for each step, without a number in it, declares no context any more."""
    walker = Walker(context=())
    folder = tmp_path / "old"
    targets = replace(TARGETS, targets=TARGETS.targets[:9])
    ran(folder, walker, targets)
    header, *rows = (folder / "steps.csv").read_text().splitlines()
    with_yaw = [header.replace(",status", ",yaw_after,status"), *(row.replace(",ok", ",nan,ok") for row in rows[:12])]
    (folder / "steps.csv").write_text("".join(f"{line}\n" for line in with_yaw))
    (folder / "summary.json").unlink()
    ran(folder, walker, targets)
    found = (folder / "steps.csv").read_text().splitlines()
    assert [line.replace(",yaw_after,", ",").replace(",nan,ok", ",ok") for line in found] == [header, *rows]
    assert len(Run(folder, space=walker.space).steps) == 18


def test_a_column_that_is_no_context_is_refused(old: Path) -> None:
    path = old / "steps.csv"
    path.write_text(path.read_text().replace("yaw_after", "yaw", 1))
    with pytest.raises(ValueError, match="line 1: the columns must be iteration,step,speed"):
        read_step_log(path, Walker().space)
    with pytest.raises(ValueError, match="line 1: the columns must be"), StepWriter(path, Walker().space):
        pass


def test_settings_that_declare_more_context_than_was_recorded_leave_it_out(run: Path) -> None:
    """As of a run on flat ground whose settings were given a measured profile later."""
    space = with_context(Walker().space, ("track",))
    assert space.context == (TRACK,)
    height = replace(space.state[1], above="ground")
    above = with_context(replace(space, state=(space.state[0], height), context=(TRACK, GROUND)), ("track", "new"))
    assert (above.is_above_context, above.context_names) == (False, ("track", "new"))
    assert with_context(Walker().space, ("track", "ground")) == read_step_log(run / "steps.csv", Walker().space).space
