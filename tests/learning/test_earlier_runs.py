"""Earlier runs are learned from as long as they may be of the same robot, and left out when its steps say otherwise."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.learning.earlier_runs import EarlierRuns
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.prior_evidence import residual_with
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep
from stepgap.step import StepStatus
from tests.control.maps import LossyHopper
from tests.learning.test_learner import NOMINAL, ONLINE, REALITY, after, hops, log_of

OTHER = LossyHopper(loss=0.3, keep=0.8, drift=-0.05)
THIRD = LossyHopper(loss=0.55, keep=0.7, drift=0.02)
POINTS = np.array([[0.2, 0.58, 1.0, -2.0]])


def runs_of(*robots: LossyHopper, steps: int = 30, seed: int = 10) -> list[LoggedStep]:
    """One run of each robot, numbered as earlier runs are: between two of them a number is missing."""
    first = -2 * len(robots) + 1
    return [
        logged
        for number, robot in enumerate(robots)
        for logged in hops(robot, steps, seed=seed + number, iteration=first + 2 * number)
    ]


def left_out(*robots: LossyHopper, own: int, seed: int = 3) -> list[int]:
    runs = EarlierRuns.of(log_of(runs_of(*robots, seed=100 * seed)), NOMINAL, [])
    return sorted(runs.of_others(observe(log_of(hops(REALITY, own, seed=seed)), NOMINAL)))


@pytest.mark.parametrize("own", [2, 3, 10, 20])
def test_a_run_of_another_robot_is_left_out(own: int) -> None:
    assert left_out(OTHER, own=own) == [-1]


@pytest.mark.parametrize("own", [3, 10])
def test_of_a_fleet_the_run_of_the_same_robot_remains(own: int) -> None:
    assert left_out(OTHER, REALITY, THIRD, own=own) == [-5, -1]


def test_before_the_first_step_all_are_kept() -> None:
    assert left_out(OTHER, THIRD, own=0) == []


@pytest.mark.parametrize("own", [0, 1, 2, 3, 5, 10, 20])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_runs_of_the_same_robot_are_hardly_ever_left_out(own: int, count: int) -> None:
    assert sum(bool(left_out(*[REALITY] * count, own=own, seed=seed)) for seed in range(20)) <= 1


def test_the_odds_are_those_of_a_fit_to_all_steps() -> None:
    """Evidence by sums is the evidence of polynomials that were fitted to the steps themselves."""
    known, own = log_of(runs_of(OTHER)), log_of(hops(REALITY, 4, seed=1))
    runs, steps = EarlierRuns.of(known, NOMINAL, []), [observe(each, NOMINAL) for each in (known, own, known + own)]
    found = [residual_with(None, each).regressions for each in steps]
    alone, mine, together = (sum(each.log_evidence for each in one) for one in found)  # pyright: ignore[reportAttributeAccessIssue]
    odds = np.exp(-(together - alone - mine))
    for factor, expected in ((0.9, frozenset()), (1.1, frozenset({-1}))):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("stepgap.learning.earlier_runs.SAME_ROBOT_ODDS", odds / factor)
            assert runs.of_others(steps[1]) == expected


def test_a_run_that_was_left_out_returns_only_from_even_odds_on() -> None:
    own = observe(log_of(hops(REALITY, 10, seed=3)), NOMINAL)
    runs = EarlierRuns.of(log_of(runs_of(REALITY)), NOMINAL, [])
    assert runs.of_others(own, frozenset({-1})) == frozenset()
    assert runs.of_others(own.selected(np.arange(0)), frozenset({-1})) == {-1}


def test_deployments_that_fell_at_once_belong_to_their_run() -> None:
    """All steps of a run are left out, also failed ones, of which commands would be avoided."""
    fallen = hops(OTHER, 1, seed=1, iteration=-2)[0]
    record = replace(fallen.record, status=StepStatus.FELL, next_state=np.full(2, np.nan))
    fallen = replace(fallen, record=record)
    around = [hops(OTHER, 20, seed=seed, iteration=number) for seed, number in ((2, -3), (3, -1))]
    known = log_of([*around[0], fallen, *around[1], *hops(REALITY, 10, seed=4)])
    learner = Learner.start(NOMINAL, known, LearningSettings(), 1)
    assert learner.left_out == {-3, -2, -1}
    assert not len(learner.failures)
    assert not learner.log.has_earlier_runs


def test_online_the_learner_begins_again_without_the_other_robot() -> None:
    steps, known = hops(REALITY, 12, seed=1), log_of(runs_of(OTHER))
    learner = after(Learner.start(NOMINAL, known, ONLINE, 0), steps)
    assert [alarm.source for alarm in learner.alarms].count("other_robot") == 1
    assert len(learner.known) == len(known) + len(steps)
    assert learner.log.iterations == [0]
    alone = after(Learner.start(NOMINAL, log_of([]), ONLINE, 0), steps)
    np.testing.assert_allclose(learner.residual.mean(POINTS), alone.residual.mean(POINTS), atol=0.01)


def test_online_the_right_run_of_a_fleet_is_learned_from() -> None:
    steps, known = hops(REALITY, 12, seed=1), log_of(runs_of(OTHER, REALITY, THIRD, OTHER))
    learner = after(Learner.start(NOMINAL, known, ONLINE, 0), steps)
    assert learner.log.iterations == [-5, 0]
    right = after(Learner.start(NOMINAL, log_of(runs_of(REALITY)), ONLINE, 0), steps)
    np.testing.assert_allclose(learner.residual.mean(POINTS), right.residual.mean(POINTS), atol=0.01)


def test_online_the_same_robot_is_not_left_out() -> None:
    learner = after(Learner.start(NOMINAL, log_of(runs_of(REALITY)), ONLINE, 0), hops(REALITY, 25, seed=1))
    assert len(learner.log) == len(learner.known) == 55
    assert not [alarm for alarm in learner.alarms if alarm.source == "other_robot"]


def test_between_deployments_the_other_robot_is_left_out() -> None:
    own = hops(REALITY, 30, seed=1)
    learner = Learner.start(NOMINAL, log_of([*runs_of(OTHER), *own]), LearningSettings(), 1)
    assert learner.log.iterations == [0]
    alone = Learner.start(NOMINAL, log_of(own), LearningSettings(), 1)
    np.testing.assert_array_equal(learner.residual.mean(POINTS), alone.residual.mean(POINTS))
