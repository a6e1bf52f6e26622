"""Exploratory hops: each reduces the uncertainty that matters for the reference more than other hops would."""

from functools import reduce

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.exploration import LEAST_WORTH, exploration_plan, goals_of, worth_of_steps
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.posterior import Posterior
from stepgap.learning.prior import Prior, fit_prior
from stepgap.learning.residual import Residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.model_plant import ModelPlant
from tests.control.maps import LossyHopper
from tests.learning.test_learner import NOISE, NOMINAL, REALITY, fitted, hops, log_of

REFERENCE = Reference.from_segments(
    ("speed", "height"), [(1, (0.1, 0.55)), (8, (0.3, 0.58)), (16, (0.1, 0.61))], steps=24
)
NO_FAILURES = np.empty((0, 4))


def test_goals_are_the_steps_of_the_reference() -> None:
    goals = goals_of(REFERENCE, NOMINAL)
    assert goals.weights.sum() == len(REFERENCE)
    assert len(goals.points) == 5  # three targets held, two changes
    np.testing.assert_allclose(sorted(goals.weights), [1, 1, 7, 7, 8])
    for point in goals.points:
        following = NOMINAL(point[:2], point[2:])
        assert np.isclose(following, REFERENCE.targets).all(axis=1).any() or (np.abs(point[2:]) > 14.9).any()


def test_an_exploratory_step_is_more_informative_than_the_middle_of_the_bounds() -> None:
    residual = fitted(hops(REALITY, 6, seed=0))
    step_map = CorrectedMap(NOMINAL, residual)
    goals, state = goals_of(REFERENCE, step_map), np.array([0.2, 0.58])
    plan = exploration_plan(CautiousController(step_map, NOMINAL, NO_FAILURES), residual, state, goals)
    chosen = goals.uncertainty_after(residual, np.append(state, plan.command))
    middle = goals.uncertainty_after(residual, np.append(state, NOMINAL.space.command_centre))
    assert chosen < middle < goals.uncertainty_after(residual)


def test_exploratory_steps_come_first_and_stay_in_the_range_of_the_reference() -> None:
    plant = ModelPlant(REALITY, np.array([0.1, 0.55]), NOISE, np.random.default_rng(0))
    learner = Learner.start(NOMINAL, log_of([]), LearningSettings(exploration=10), iteration=0)
    steps = list(deploy(learner, plant, REFERENCE, 0, exploration=10))
    assert [logged.step for logged in steps] == list(range(-9, len(REFERENCE) + 1))
    lower, upper = REFERENCE.targets.min(axis=0), REFERENCE.targets.max(axis=0)
    room = 0.2 * NOMINAL.space.state_scale + 4 * NOISE
    ends = Steps(NOMINAL.space, steps[3:10]).next_state  # before the first ones nothing is known of the robot
    assert ((ends >= lower - room) & (ends <= upper + room)).all()


def tracked_error(exploration: int) -> np.ndarray:
    plant = ModelPlant(REALITY, np.array([0.1, 0.55]), NOISE, np.random.default_rng(1))
    learner = Learner.start(NOMINAL, log_of([]), LearningSettings(exploration=exploration), iteration=0)
    tracked = [logged for logged in deploy(learner, plant, REFERENCE, 0, exploration) if logged.step > 0]
    error = [logged.record.next_state - logged.target for logged in tracked]
    return np.sqrt(np.mean(np.square(error), axis=0))


def test_exploration_reduces_the_error_of_the_first_deployment() -> None:
    assert isinstance(REALITY, LossyHopper)
    assert (tracked_error(12) < 0.7 * tracked_error(0)).all()


# With a prior


@pytest.fixture(scope="module")
def prior() -> Prior:
    """That of 30 hoppers that lose more or less, and drift."""
    rng, robots = np.random.default_rng(0), []
    for seed in range(30):
        hopper = LossyHopper(loss=rng.uniform(0.3, 0.6), keep=rng.uniform(0.5, 0.9), drift=rng.uniform(-0.1, 0.1))
        robots.append(observe(log_of(hops(hopper, 20, seed)), NOMINAL))
    return fit_prior(robots)


def believed(prior: Prior, steps: list[LoggedStep]) -> Residual:
    """What is believed of the error of a hopper after these steps of a deployment."""
    learner = Learner.start(NOMINAL, log_of([]), LearningSettings(online=True), 0, [prior])
    return reduce(Learner.after, steps, learner).conditioned_residual


def test_the_expected_loss_is_that_of_linear_regression(prior: Prior) -> None:
    residual = believed(prior, [])
    goals, space = goals_of(REFERENCE, CorrectedMap(NOMINAL, residual)), NOMINAL.space
    expected, noise = 0.0, residual.noise_std / space.state_scale
    for each, std in zip(residual.regressions, noise, strict=True):
        assert isinstance(each, Posterior)
        size = each.features.count
        covariance = each.covariance[:size, :size].copy()
        for phi in each.features(space.scaled_inputs(goals.points[:, :2], goals.points[:, 2:])):
            variance = phi @ covariance @ phi
            expected += variance
            covariance -= np.outer(covariance @ phi, phi @ covariance) / (variance + std**2)
    loss = goals.expected_loss(residual, residual.noise_std)
    assert loss == pytest.approx(expected / np.sum(noise**2), rel=1e-6)


def worths_of(residual: Residual, most: int = 20) -> list[float]:
    controller = CautiousController(CorrectedMap(NOMINAL, residual), NOMINAL, NO_FAILURES)
    return worth_of_steps(controller, residual, REFERENCE, most)


def test_steps_are_worth_less_and_less_until_one_is_not_worth_it(prior: Prior) -> None:
    residual = believed(prior, [])
    worths = worths_of(residual)
    assert 1 < len(worths) < 20
    assert all(each >= LEAST_WORTH for each in worths[:-1])
    assert worths[-1] < LEAST_WORTH
    assert worths[0] == max(worths)
    assert worths_of(residual, most=1) == worths[:1]


def test_what_is_known_is_not_explored(prior: Prior) -> None:
    residual = believed(prior, hops(REALITY, 60, seed=1))
    assert worths_of(residual)[0] < LEAST_WORTH
