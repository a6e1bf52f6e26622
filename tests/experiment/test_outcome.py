"""The outcome of a deployment: cut commands, unreachable and missed targets, true errors, at torque limits."""

from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.outcome import (
    count_cut,
    estimate_noise_floor,
    missed_targets,
    summarise,
    unreachable_targets,
)
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array, StepRecord, StepStatus
from tests.control.maps import LossyHopper

MAP = LossyHopper()
LOW, HIGH, FAR = (0.1, 0.56), (0.2, 0.6), (0.2, 0.9)


def log_of(targets: Array, error: Array, true_error: Array, removed: Array) -> Steps:
    """Steps with these errors; their applied commands lack the removed parts."""
    rows = zip(targets, error, true_error, removed, strict=True)
    steps = [
        LoggedStep(0, number, target, target, np.zeros(2), StepRecord(
            target, np.ones(2), np.ones(2) - cut, target + off, StepStatus.OK, true_next_state=target + true_off
        ))
        for number, (target, off, true_off, cut) in enumerate(rows, 1)
    ]  # fmt: skip
    return Steps(MAP.space, steps)


def test_true_errors_and_cut_commands_by_hand() -> None:
    reference = Reference(MAP.space.state_names, np.tile(LOW, (4, 1)))
    error, true_error = np.full((4, 2), 0.1), np.array([[0.3, 0.0], [0.0, 0.4], [0.0, 0.0], [0.0, 0.0]])
    scale = MAP.space.command_scale
    removed = np.array([[0.0, 0.0], [0.009 * scale[0], 0.0], [0.0, 0.011 * scale[1]], [-0.02 * scale[0], 0.0]])
    steps = log_of(reference.targets, error, true_error, removed)
    found = summarise(steps, reference, "none", MAP)
    assert found.rmse == pytest.approx([0.1, 0.1])
    assert found.true_rmse == pytest.approx([0.15, 0.2])
    assert (found.cut, count_cut(steps)) == (2, 2)
    unknown = summarise(log_of(reference.targets, error, np.full((4, 2), np.nan), removed), reference, "none")
    assert np.isnan(unknown.true_rmse).all()


def test_unreachable_targets_are_those_without_a_fixed_point() -> None:
    reference = Reference(MAP.space.state_names, np.array([LOW, HIGH, FAR, HIGH]))
    np.testing.assert_array_equal(unreachable_targets(MAP, reference), [FAR])

    class Noisy(LossyHopper):
        @property
        def noise_std(self) -> Array:
            return np.array([0.01, 1.0])

    assert not len(unreachable_targets(Noisy(), reference)), "its miss is within the noise of one step"


def test_missed_targets_are_reachable_but_have_an_error_of_more_than_three_noise_floors() -> None:
    targets = np.repeat([(0.0, 0.55), LOW, HIGH, FAR], 40, axis=0)
    reference = Reference(MAP.space.state_names, targets)
    error = np.random.default_rng(0).normal(size=targets.shape) * [0.01, 0.002]
    error[80:] += [0.08, 0.0]
    steps = log_of(targets, error, error, np.zeros_like(error))
    # A constant error cannot be distinguished from an effect of the state, so both shifted targets are missed.
    floor = estimate_noise_floor(steps, reference).any_phase
    np.testing.assert_array_equal(missed_targets(steps, reference, np.empty((0, 2)), floor), [HIGH, FAR])
    np.testing.assert_array_equal(missed_targets(steps, reference, np.array([FAR]), floor), [HIGH])
    np.testing.assert_array_equal(summarise(steps, reference, "none", MAP, floor).missed, [HIGH])
    np.testing.assert_array_equal(summarise(steps, reference, "none", MAP).missed, [HIGH])
    few = replace(reference, targets=targets[:3])
    assert missed_targets(Steps(MAP.space, list(steps)[:3]), few, np.empty((0, 2)), floor).shape == (0, 2)


def test_what_torque_limits_remove_is_learned() -> None:
    """With limits that cut every command, the redeployment predicts and tracks as without limits."""
    nominal = ApexMap()
    reference = Reference(nominal.space.state_names, paper_reference().targets[80:100])
    gap = RealityGap(torque_limit=13.0)

    def deployed(log: Steps, iteration: int) -> Steps:
        learner = Learner.start(nominal, log, LearningSettings(), iteration)
        twin = Twin(nominal.robot, gap, random_stream(5, iteration))
        plant = RigPlant(twin, HopperControl(nominal.robot, nominal.gains, nominal.bounds))
        with closing(deploy(learner, plant, reference, iteration)) as steps:
            return Steps(nominal.space, steps)

    first = deployed(Steps(nominal.space), 0)
    second = deployed(first, 1)
    before, after = (summarise(log, reference, "") for log in (first, second))
    assert before.cut > 18
    assert after.cut > 18
    assert (np.abs(after.bias) < [0.01, 0.003]).all()
    assert (after.rmse < [0.03, 0.006]).all()
    assert (before.rmse > [0.08, 0.015]).all()
    inside = np.abs(second.next_state - second.predicted) < 1.96 * second.std
    assert (inside.mean(axis=0) > 0.85).all()
