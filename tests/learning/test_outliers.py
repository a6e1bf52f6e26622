"""Single steps with improbable errors are found and not learned from; a lasting change is learned."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.learning.entry_points import residual_models
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.outliers import IMPROBABLE, LEAST_KNOWN, OUTLIER_PROBABILITY, OUTLIER_WIDTH, outliers_among
from stepgap.learning.residual_fit import learned_residual, residual_from_dict
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepRecord, StepStatus
from tests.control.maps import LossyHopper

NOMINAL, REALITY = LossyHopper(), LossyHopper(loss=0.45, keep=0.6, drift=0.09)
NOISE, SCALE = np.array([0.008, 0.0013]), NOMINAL.space.state_scale
KEEPING = LearningSettings(reject_outliers=False)
KINDS = [model.name for model in residual_models() if model.name != "none" and model.lagged_inputs == "none"]


def hops(count: int, seed: int, pushes: dict[int, float], iteration: int = 0) -> list[LoggedStep]:
    """Random hops; a push adds a speed to the state at the end of a hop, given by its number."""
    rng, space, state, steps = np.random.default_rng(seed), NOMINAL.space, np.array([0.2, 0.58]), []
    for number in range(1, count + 1):
        command = rng.uniform(0.5 * space.command_lower, 0.5 * space.command_upper)
        after = REALITY(state, command) + rng.normal(0, NOISE) + [pushes.get(number, 0.0), 0.0]
        record = StepRecord(state, command, command, after, StepStatus.OK)
        steps.append(LoggedStep(iteration, number, after, after, np.zeros(2), record))
        state = np.array([rng.uniform(0, 0.4), rng.uniform(0.54, 0.62)])
    return steps


def log_of(steps: list[LoggedStep]) -> Steps:
    return Steps(NOMINAL.space, steps)


def error_of(residual, points: Array) -> float:
    """Root mean square of the error of a residual at points [half ranges]."""
    state, command = points[:, :2], points[:, 2:]
    truth = REALITY.evaluate(state, command).next_state - NOMINAL.evaluate(state, command).next_state
    return float(np.sqrt(np.mean(((residual.mean(points) - truth) / SCALE) ** 2)))


POINTS = np.random.default_rng(3).uniform([0.0, 0.54, -10, -15], [0.4, 0.62, 10, 15], (200, 4))


def test_the_threshold_is_where_both_origins_are_equally_likely() -> None:
    densities = [
        weight * np.exp(-0.5 * (IMPROBABLE / width) ** 2) / width
        for weight, width in ((1 - OUTLIER_PROBABILITY, 1.0), (OUTLIER_PROBABILITY, OUTLIER_WIDTH))
    ]
    np.testing.assert_allclose(*densities, rtol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_every_residual_leaves_pushed_steps_out(kind: str) -> None:
    pushes = {9: 0.5, 30: -0.4, 48: 0.3, 71: -0.6}
    observations = observe(log_of(hops(80, 1, pushes)), NOMINAL)
    settings = LearningSettings(residual=kind)
    robust, plain = (
        learned_residual(observations, each, 1) for each in (settings, replace(settings, reject_outliers=False))
    )
    assert {step for _, step in robust.outliers} >= set(pushes)
    assert len(robust.outliers) <= len(pushes) + 1
    assert error_of(robust, POINTS) < error_of(plain, POINTS)
    assert residual_from_dict(robust.to_dict()).outliers == robust.outliers


@pytest.mark.parametrize("kind", KINDS)
def test_without_pushes_the_fit_is_the_same_to_the_last_bit(kind: str) -> None:
    """False flags: none in these 60 steps; with four times as many, at most 1 %."""
    observations = observe(log_of(hops(60, 2, {})), NOMINAL)
    settings = LearningSettings(residual=kind)
    robust, plain = (
        learned_residual(observations, each, 1) for each in (settings, replace(settings, reject_outliers=False))
    )
    assert robust.outliers == ()
    np.testing.assert_array_equal(robust.mean(POINTS), plain.mean(POINTS))


@pytest.mark.parametrize("seed", [4, 5])
def test_clean_steps_are_rarely_called_outliers(seed: int) -> None:
    observations = observe(log_of(hops(240, seed, {})), NOMINAL)
    residual = learned_residual(observations, LearningSettings(residual="quadratic"), 1)
    assert len(residual.outliers) <= 0.01 * len(observations)


def test_steps_that_deviate_together_are_a_change_and_are_kept() -> None:
    error, std = np.zeros((6, 2)), np.ones((6, 2))
    error[[1, 3, 4], 0] = 9.0
    follows, points = np.array([False, True, True, True, True, True]), 0.3 * np.arange(6.0)[:, None]
    assert outliers_among(error, std, follows, points).tolist() == [False, True, False, False, False, False]
    apart = np.array([False, True, True, True, False, True])
    assert outliers_among(error, std, apart, points).tolist() == [False, True, False, True, True, False]
    error[4, 0] = -9.0
    assert outliers_among(error, std, follows, points).tolist() == [False, True, False, True, True, False]


def test_what_returns_at_similar_steps_is_no_outlier() -> None:
    """If two of three similar steps deviate in the same direction, they are kept; otherwise they are left out."""
    error, std, follows = np.zeros((9, 2)), np.ones((9, 2)), np.full(9, fill_value=True)
    points = np.repeat([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]], 3, axis=0) + 0.01 * np.arange(9.0)[:, None]
    error[[0, 2], 0] = 9.0
    error[[3, 5], 1] = 9.0, -9.0
    error[7, 0] = 9.0
    expected = [False, False, False, True, False, True, False, True, False]
    assert outliers_among(error, std, follows, points).tolist() == expected


def test_if_too_many_steps_seem_to_be_outliers_all_are_learned() -> None:
    pushes = dict.fromkeys(range(3, 61, 3), 0.6)
    observations = observe(log_of(hops(60, 6, pushes)), NOMINAL)
    assert learned_residual(observations, LearningSettings(residual="linear"), 1).outliers == ()


def test_a_few_steps_are_all_learned() -> None:
    observations = observe(log_of(hops(LEAST_KNOWN - 1, 7, {4: 0.6})), NOMINAL)
    assert learned_residual(observations, LearningSettings(residual="linear"), 1).outliers == ()


def test_a_push_during_a_deployment_does_not_shift_the_correction() -> None:
    known, after_push = log_of(hops(60, 8, {})), hops(25, 9, {20: 0.6}, iteration=1)
    settings = LearningSettings(online=True)
    robust, plain = (
        Learner.start(NOMINAL, known, each, 1) for each in (settings, replace(settings, reject_outliers=False))
    )
    for logged in after_push[:19]:
        robust, plain = robust.after(logged), plain.after(logged)
    before, robust, plain = robust, robust.after(after_push[19]), plain.after(after_push[19])
    assert robust.outliers == ((1, 20),)
    state, command = POINTS[:, :2], POINTS[:, 2:]
    shift = (
        robust.step_map().evaluate(state, command).next_state - before.step_map().evaluate(state, command).next_state
    )
    assert np.abs(shift / SCALE).max() < 1e-9
    other = plain.step_map().evaluate(state, command).next_state - before.step_map().evaluate(state, command).next_state
    assert np.abs(other / SCALE).max() > 0.05


def test_a_lasting_change_is_learned_after_its_first_step() -> None:
    """After a large error in the first step of a warm start at once: the robot may be another one."""
    for first, known_in, outliers in ((1, -1, ()), (1, 0, ((1, 1),)), (5, 0, ((1, 5),))):
        known = log_of(hops(60, 10, {}, iteration=known_in))
        learner = Learner.start(NOMINAL, known, LearningSettings(online=True), 1)
        changed = hops(12, 11, dict.fromkeys(range(first, 13), 0.3), iteration=1)
        for logged in changed[: first + 1]:
            learner = learner.after(logged)
        assert learner.outliers == outliers
        for logged in changed[first + 1 :]:
            learner = learner.after(logged)
    last = changed[-1].record
    assert abs(learner.step_map()(last.state, last.command)[0] - last.next_state[0]) < 0.1
