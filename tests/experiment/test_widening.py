"""Commands widen from deployment to deployment, from those of deployments that did not fall."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus
from tests.control.maps import ClosedFormMap

STATE = tuple(Quantity(name, "", -1.0, 1.0) for name in ("vx", "vy", "wz"))
COMMAND = tuple(Quantity(name, "", -3.0, 3.0) for name in ("cx", "cy", "cw"))
SPACE = StepSpace(STATE, COMMAND, planar_seconds=0.5)
TARGETS = np.array([[0.2, 0.0, 0.0], [0.6, 0.1, -0.1], [0.0, -0.1, 0.1]]).repeat(4, axis=0)


@dataclass(frozen=True)
class Slow(ClosedFormMap):
    """A body that does a part of what it is told."""

    part: float = 1.0

    @property
    def space(self) -> StepSpace:
        return SPACE

    def next_state(self, state: Array, command: Array) -> Array:
        return self.part * command + 0 * state


def deployed(learner: Learner, control: ControlSettings) -> Steps:
    plant = ModelPlant(Slow(0.4), np.zeros(3))
    reference = Reference(SPACE.state_names, TARGETS)
    return Steps(SPACE, deploy(learner, plant, reference, learner.iteration, 0, control))


def distances(steps: Steps) -> Array:
    return np.abs(steps.command - steps.state)


def test_a_command_is_not_farther_than_those_before_by_more_than_the_widening() -> None:
    first = deployed(Learner.start(Slow(), Steps(SPACE), LearningSettings(), 0), ControlSettings(widening=0.1))
    learner = Learner.start(Slow(), first, LearningSettings(), 1)
    limit = 1.1 * distances(first).max(axis=0)
    assert (distances(deployed(learner, ControlSettings())).max(axis=0) > limit).any()
    assert (distances(deployed(learner, ControlSettings(widening=0.1))) <= limit + 1e-5).all()


def test_a_deployment_that_fell_does_not_count() -> None:
    """Its commands may be why."""
    first = deployed(Learner.start(Slow(), Steps(SPACE), LearningSettings(), 0), ControlSettings())
    wild = replace(first[0], iteration=1, record=replace(first[0].record, requested=np.full(3, 2.5)))
    fall = replace(wild, record=replace(wild.record, status=StepStatus.FELL))
    both = Learner.start(Slow(), first + [wild, fall], LearningSettings(), 2)  # noqa: RUF005
    np.testing.assert_allclose(both.farthest, distances(first).max(axis=0))
    only = Learner.start(Slow(), Steps(SPACE, [wild, fall]), LearningSettings(), 2)
    np.testing.assert_allclose(only.farthest, 2.5)


def test_before_the_first_deployment_nothing_is_known() -> None:
    assert np.isinf(Learner.start(Slow(), Steps(SPACE), LearningSettings(), 0).farthest).all()


def test_a_widening_that_leaves_no_command_is_refused() -> None:
    with pytest.raises(ValueError, match="widening"):
        ControlSettings(widening=-1.0)


class Deaf(ModelPlant):
    """A robot that runs away for some steps, whatever it is told."""

    def __init__(self) -> None:
        super().__init__(Slow(0.4), np.zeros(3))
        self._number = 0

    def take_step(self, command: Array) -> StepRecord:
        record = super().take_step(command)
        self._number += 1
        if 4 < self._number <= 8:
            self._state = np.array([0.9, 0.3, 0.0])
            record = replace(record, next_state=self._state)
        return record


@pytest.mark.parametrize(("surprise", "told"), [(0.1, True), (np.inf, False)])
def test_a_robot_that_does_not_follow_is_told_its_target(surprise: float, told: bool) -> None:
    first = deployed(Learner.start(Slow(), Steps(SPACE), LearningSettings(), 0), ControlSettings())
    learner = Learner.start(Slow(), first, LearningSettings(), 1)
    reference = Reference(SPACE.state_names, TARGETS)
    control = ControlSettings(surprise=surprise)
    steps = Steps(SPACE, deploy(learner, Deaf(), reference, 1, 0, control))
    is_target = np.all(np.abs(steps.command - TARGETS) < 1e-12, axis=1).tolist()
    assert is_target[5] == told
    assert not any(is_target[:5])
    assert not is_target[11]
