"""The intervals of a deployment are calibrated while it goes on, and its commands do not depend on that."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.normal import INTERVAL_95
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import DeploymentController, deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.step import Array
from tests.control.maps import NeverWorks
from tests.learning.test_learner import NOISE, NOMINAL, REALITY, hops, log_of

TARGETS = np.random.default_rng(5).uniform([0.05, 0.55], [0.35, 0.61], (45, 2)).repeat(4, axis=0)


@pytest.fixture(scope="module")
def learner() -> Learner:
    """One whose residual alone is learned: beliefs would find the noise of the robot by themselves."""
    return Learner.start(NOMINAL, log_of(hops(REALITY, 60, seed=0)), LearningSettings("linear", drift=False), 1)


def deployment(learner: Learner, noise: Array) -> Steps:
    plant = ModelPlant(REALITY, np.array([0.1, 0.55]), noise, np.random.default_rng(1))
    reference = Reference(("speed", "height"), TARGETS)
    return Steps(NOMINAL.space, list(deploy(learner, plant, reference, 1)))


def coverage(steps: Steps, std: Array) -> Array:
    return np.mean(np.abs(steps.next_state - steps.predicted)[60:] <= INTERVAL_95 * std[60:], axis=0)


def test_a_noisier_robot_than_the_one_learned_has_wider_intervals(learner: Learner) -> None:
    """Commands and predictions are those of a controller without calibration, whose intervals are too narrow."""
    steps, controller, stated = deployment(learner, 2.5 * NOISE), DeploymentController.start(learner), []
    for logged in steps:
        plan = controller.plan(logged.record.state, logged.target)
        assert plan.command.tolist() == logged.record.command.tolist()
        assert plan.predicted.tolist() == logged.predicted.tolist()
        stated.append(plan.std)
        controller = replace(controller.after(logged), calibration=None)
    assert np.all(coverage(steps, np.array(stated)) < 0.8)
    assert np.all(np.abs(coverage(steps, steps.std) - 0.95) < 0.06)


def test_without_a_correction_there_are_no_intervals_to_calibrate() -> None:
    learner = Learner.start(NOMINAL, log_of([]), LearningSettings("none"), 0)
    steps, controller = deployment(learner, NOISE), DeploymentController.start(learner)
    assert not steps.std.any()
    for logged in steps:
        controller = controller.after(logged)
    assert controller.calibration is None


def test_steps_without_a_command_are_said_once() -> None:
    learner = Learner.start(NeverWorks(), log_of([]), LearningSettings("none"), 0)
    reference = Reference(("speed", "height"), TARGETS[:3])
    said = list[str]()
    plant = ModelPlant(REALITY, np.array([0.1, 0.55]))
    steps = Steps(NOMINAL.space, list(deploy(learner, plant, reference, 0, on_warning=said.append)))
    assert np.isnan(steps.predicted).all()
    (sentence,) = said
    assert sentence.startswith("step 1: the search found no command")
    assert "control.evaluations" in sentence
