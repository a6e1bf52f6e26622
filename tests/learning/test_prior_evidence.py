"""Earlier runs are learned from as long as they may be of the same robot, and left out when its steps say otherwise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.polynomial import NOISE_SCALE, PRIOR_COUNT
from stepgap.learning.prior import fit_prior
from stepgap.learning.prior_evidence import applies, log_evidence_of_none, other_robots, residual_with
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from tests.control.maps import LossyHopper
from tests.learning.test_learner import NOMINAL, ONLINE, REALITY, after, hops, log_of

OTHER = LossyHopper(loss=0.3, keep=0.8, drift=-0.05)
THIRD = LossyHopper(loss=0.55, keep=0.7, drift=0.02)


def runs_of(*robots: LossyHopper, steps: int = 30) -> list[LoggedStep]:
    """One run of each robot, numbered as earlier runs are: between two of them a number is missing."""
    first = -2 * len(robots) + 1
    return [
        logged
        for number, robot in enumerate(robots)
        for logged in hops(robot, steps, seed=10 + number, iteration=first + 2 * number)
    ]


def left_out(*robots: LossyHopper, own: int) -> list[int]:
    steps = Steps(NOMINAL.space, [*runs_of(*robots), *hops(REALITY, own, seed=3)])
    return other_robots(observe(steps, NOMINAL), [])


@pytest.mark.parametrize("own", [0, 1, 2, 3, 10, 20])
def test_a_run_of_the_same_robot_is_kept(own: int) -> None:
    assert left_out(REALITY, own=own) == []


@pytest.mark.parametrize("own", [2, 3, 10, 20])
def test_a_run_of_another_robot_is_left_out(own: int) -> None:
    assert left_out(OTHER, own=own) == [-1]


def test_before_the_first_step_all_are_kept() -> None:
    assert left_out(OTHER, THIRD, own=0) == []


@pytest.mark.parametrize("own", [3, 10])
def test_of_a_fleet_the_run_of_the_same_robot_remains(own: int) -> None:
    assert left_out(OTHER, REALITY, THIRD, own=own) == [-5, -1]


def test_runs_that_agree_are_one_robot() -> None:
    assert left_out(REALITY, REALITY, own=5) == []


def test_seeds_decide_nothing() -> None:
    """Of 40 robots with runs of their own and of others, hardly any is taken for another one."""
    wrong = 0
    for seed in range(40):
        steps = Steps(NOMINAL.space, [*runs_of(OTHER, REALITY), *hops(REALITY, 4, seed=100 + seed)])
        wrong += other_robots(observe(steps, NOMINAL), []) != [-3]
    assert wrong <= 2


@pytest.mark.parametrize("seed", range(5))
def test_the_evidence_of_noise_is_that_of_the_t_distribution(seed: int) -> None:
    found = observe(log_of(hops(REALITY, 7, seed=seed)), NOMINAL)
    shape = NOISE_SCALE**2 * np.eye(len(found))
    errors = (found.error / NOMINAL.space.state_scale).T
    expected = sum(stats.multivariate_t(shape=shape, df=PRIOR_COUNT).logpdf(each) for each in errors)
    units = len(found) * np.sum(np.log(NOMINAL.space.state_scale))
    assert log_evidence_of_none(found) == pytest.approx(expected - units + found.error.size / 2 * np.log(2 * np.pi))


def test_a_prior_is_dropped_where_the_nominal_map_is_right_but_for_noise() -> None:
    """The weak prior, which expects little noise, is no rival there."""
    rng, kind = np.random.default_rng(0), []
    for seed in range(30):
        hopper = LossyHopper(loss=rng.uniform(0.4, 0.6), keep=rng.uniform(0.5, 0.7), drift=rng.uniform(0.1, 0.2))
        kind.append(observe(log_of(hops(hopper, 20, seed)), NOMINAL))
    prior = fit_prior(kind)
    for each in kind[:10]:
        found = each.selected(np.arange(4))
        assert applies(residual_with(prior, found), found)
        noise = replace(found, error=0.15 * NOMINAL.space.state_scale * rng.standard_normal((4, 2)))
        assert not applies(residual_with(prior, noise), noise)


def test_online_the_learner_starts_again_without_the_other_robot() -> None:
    steps = hops(REALITY, 12, seed=1)
    known = log_of(runs_of(OTHER))
    learner = after(Learner.start(NOMINAL, known, ONLINE, 0), steps)
    assert [alarm.source for alarm in learner.alarms].count("other") == 1
    assert len(learner.known) == len(known) + len(steps)
    assert learner.log.iterations == [0]
    alone = after(Learner.start(NOMINAL, log_of([]), ONLINE, 0), steps)
    points = np.array([[0.2, 0.58, 1.0, -2.0]])
    np.testing.assert_allclose(learner.residual.mean(points), alone.residual.mean(points), atol=0.01)


def test_online_the_same_robot_is_not_left_out() -> None:
    learner = after(Learner.start(NOMINAL, log_of(runs_of(REALITY)), ONLINE, 0), hops(REALITY, 25, seed=1))
    assert len(learner.log) == len(learner.known) == 55
    assert not [alarm for alarm in learner.alarms if alarm.source == "other"]


def test_between_deployments_the_other_robot_is_left_out() -> None:
    known = log_of([*runs_of(OTHER), *hops(REALITY, 30, seed=1)])
    learner = Learner.start(NOMINAL, known, LearningSettings(), 1)
    assert learner.log.iterations == [0]
    alone = Learner.start(NOMINAL, log_of(hops(REALITY, 30, seed=1)), LearningSettings(), 1)
    points = np.array([[0.2, 0.58, 1.0, -2.0]])
    np.testing.assert_array_equal(learner.residual.mean(points), alone.residual.mean(points))
