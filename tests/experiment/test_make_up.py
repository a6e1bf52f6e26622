"""What steps fell short of their targets is made up for: a robot with a drift that nobody knows keeps its place."""

from dataclasses import dataclass

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.step import Array, Quantity, StepSpace
from tests.control.maps import ClosedFormMap

SPACE = StepSpace((Quantity("v", "m/s", -1.0, 1.0),), (Quantity("c", "m/s", -2.0, 2.0),))
STEPS = 60


@dataclass(frozen=True)
class Drifting(ClosedFormMap):
    """A body that is faster than it is told."""

    drift: float = 0.0

    @property
    def space(self) -> StepSpace:
        return SPACE

    def next_state(self, state: Array, command: Array) -> Array:
        return command + self.drift + 0 * state


def errors(make_up: int, drift: float) -> Array:
    """Errors of a deployment with the map that knows nothing of the drift."""
    learner = Learner.start(Drifting(), Steps(SPACE, []), LearningSettings(residual="none"), 0)
    plant = ModelPlant(Drifting(drift), np.zeros(1))
    reference = Reference(("v",), np.full((STEPS, 1), 0.4))
    control = ControlSettings(make_up=make_up)
    return np.array([step.record.next_state - step.target for step in deploy(learner, plant, reference, 0, 0, control)])


def test_the_place_that_is_lost_is_that_of_an_integrator() -> None:
    """The sum S of what is short follows S⁺ = S (1 − 1/N) − drift, whose end is −drift N."""
    assert errors(0, 0.02).sum() == pytest.approx(STEPS * 0.02)
    short = np.cumsum(errors(6, 0.02)[:, 0])
    np.testing.assert_allclose(short, 0.02 * 6 * (1 - (1 - 1 / 6) ** np.arange(1, STEPS + 1)), atol=1e-6)


def test_a_target_is_moved_by_two_fifths_of_half_a_range_at_most() -> None:
    assert errors(6, 0.7)[-1] == pytest.approx(0.3, abs=1e-6)


@pytest.mark.parametrize("make_up", [-1, 1001])
def test_numbers_of_steps_out_of_range_are_refused(make_up: int) -> None:
    with pytest.raises(ValueError, match="make_up = "):
        ControlSettings(make_up=make_up)
