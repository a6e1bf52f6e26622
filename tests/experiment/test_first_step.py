"""The step that a plant takes before the first planned one is recorded and learned from, and counts in no error."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.experiment.bands import interval_coverage
from stepgap.experiment.deployment import deploy
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array, StepRecord, StepSpace
from tests.control.maps import LossyHopper

NOMINAL, REALITY = LossyHopper(), LossyHopper(loss=0.45, keep=0.6, drift=0.09)
SPACE, NOISE, RELEASED = NOMINAL.space, np.array([0.004, 0.001]), np.array([0.1, 0.55])
REFERENCE = Reference(("speed", "height"), np.random.default_rng(5).uniform([0.05, 0.55], [0.3, 0.6], (12, 2)))
ONLINE = LearningSettings("linear", iterations=1, online=True)
LATER = LearningSettings("linear", iterations=1)


class ReleasedPlant(Plant):
    """A plant that is released at a section, and takes a step without a command when it starts."""

    def __init__(self, rng: np.random.Generator):
        self._plant = ModelPlant(REALITY, RELEASED, NOISE, rng)
        self._first: StepRecord | None = None

    @property
    def space(self) -> StepSpace:
        return self._plant.space

    @property
    def first_step(self) -> StepRecord | None:
        return self._first

    def start(self) -> Array:
        self._plant.start()
        self._first = self._plant.take_step(np.zeros(2))
        return self._first.next_state

    def take_step(self, command: Array) -> StepRecord:
        return self._plant.take_step(command)

    def stop(self) -> None:
        self._plant.stop()


def lowered(rng: np.random.Generator) -> Plant:
    """A plant whose first state is no end of a step."""
    return ModelPlant(REALITY, RELEASED, NOISE, rng)


def deployment(settings: LearningSettings, exploration: int = 0) -> list[LoggedStep]:
    learner = Learner.start(NOMINAL, Steps(SPACE), settings, 0)
    return list(deploy(learner, ReleasedPlant(np.random.default_rng(1)), REFERENCE, 0, exploration))


def run_in(
    folder: Path, make: Callable[[np.random.Generator], Plant] = ReleasedPlant, learning: LearningSettings = ONLINE
) -> Path:
    folder.mkdir(exist_ok=True)
    run_experiment(Setup(NOMINAL, Plants(make), REFERENCE, learning, seed=3), folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_in(tmp_path_factory.mktemp("run"))


def test_it_is_step_0_with_the_prediction_of_the_map_and_without_a_target() -> None:
    first, second, *_ = deployment(ONLINE)
    assert (first.step, first.planned) == (0, False)
    assert (second.step, second.planned) == (1, True)
    assert np.isnan(first.target).all()
    np.testing.assert_array_equal(first.record.state, RELEASED)
    np.testing.assert_array_equal(first.predicted, NOMINAL.evaluate(RELEASED, np.zeros(2)).next_state)
    np.testing.assert_array_equal(first.record.next_state, second.record.state)


def test_step_1_is_planned_with_what_it_taught_if_the_run_learns_online() -> None:
    def correction(settings: LearningSettings) -> Array:
        """Difference of the prediction of step 1 from that of the nominal map."""
        step = deployment(settings)[1]
        return step.predicted - NOMINAL.evaluate(step.record.state, step.record.requested).next_state

    assert not correction(LATER).any()
    first = deployment(ONLINE)[0]
    error = first.record.next_state - first.predicted
    assert (np.abs(correction(ONLINE) - error) < np.abs(error) / 2).all()


def test_exploration_begins_after_it_and_has_all_its_steps() -> None:
    steps = Steps(SPACE, deployment(LearningSettings("linear", exploration=6), exploration=6))
    assert steps.number.tolist() == [*range(-6, 13)]
    assert steps.unplanned.tolist() == [True, *18 * [False]]
    assert (steps.std[1:] > 0).all(), "the first step was learned from"


def test_it_counts_in_no_number_of_a_run(folder: Path) -> None:
    run = Run(folder, space=SPACE, nominal=NOMINAL)
    assert run.recorded.number.tolist() == 2 * [*range(13)]
    assert run.steps.number.tolist() == 2 * [*range(1, 13)]
    assert [(each.steps, each.failed_steps) for each in run.deployments] == 2 * [(12, 0)]
    for each in run.deployments:
        steps = run.steps.of_iteration(each.iteration)
        np.testing.assert_allclose(each.rmse, np.sqrt(np.mean((steps.next_state - steps.target) ** 2, axis=0)))
    assert interval_coverage(run.steps.of_iteration(1))[1].tolist() == [12, 12]


def test_an_interrupted_run_is_resumed(folder: Path, tmp_path: Path) -> None:
    lines = (folder / "steps.csv").read_text().splitlines(keepends=True)
    for kept in (1, 2, 3, 13, 14, 15):
        copy = tmp_path / str(kept)
        copy.mkdir()
        (copy / "steps.csv").write_text("".join(lines[: 1 + kept]))
        run_in(copy)
        for name in ("steps.csv", "summary.json", "models/iteration_1.json"):
            assert (copy / name).read_bytes() == (folder / name).read_bytes()


def test_a_run_of_a_version_without_it_continues_after_a_whole_deployment(tmp_path: Path) -> None:
    folder = run_in(tmp_path / "run", lowered, LearningSettings("linear", iterations=0))
    run_in(folder, ReleasedPlant, LATER)
    assert read_step_log(folder / "steps.csv", SPACE).number.tolist() == [*range(1, 13), *range(13)]
    assert [each["steps"] for each in json.loads((folder / "summary.json").read_text())["iterations"]] == [12, 12]


def test_an_interrupted_deployment_of_a_version_without_it_begins_again_with_it(folder: Path, tmp_path: Path) -> None:
    begun = run_in(tmp_path / "run", lowered, LearningSettings("linear", iterations=0))
    (begun / "summary.json").unlink()
    run_in(begun)
    assert (begun / "steps.csv").read_bytes() == (folder / "steps.csv").read_bytes()
