"""Learning online gives the result of a fit to the whole log, and a correction that predicts worse is not used."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.learning.background import BackgroundThread
from stepgap.learning.gaussian_process_regression import GaussianProcessRegression
from stepgap.learning.learner import Learner
from stepgap.learning.observations import observe
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepMap, StepRecord, StepStatus
from tests.control.maps import LossyHopper

NOMINAL, REALITY = LossyHopper(), LossyHopper(loss=0.45, keep=0.6, drift=0.09)
NOISE = np.array([0.004, 0.001])
ONLINE = LearningSettings(online=True, drift=False)


def hops(reality: StepMap, count: int, seed: int, iteration: int = 0, first: int = 1) -> list[LoggedStep]:
    """Random hops, each from the state at the end of the one before."""
    rng, space, state, steps = np.random.default_rng(seed), reality.space, np.array([0.2, 0.58]), []
    for number in range(first, first + count):
        command = rng.uniform(0.5 * space.command_lower, 0.5 * space.command_upper)
        after = reality(state, command) + rng.normal(0, NOISE)
        record = StepRecord(state, command, command, after, StepStatus.OK)
        steps.append(LoggedStep(iteration, number, after, after, np.zeros(2), record))
        state = after
    return steps


DEFAULT = LearningSettings().residual


def log_of(steps: list[LoggedStep]) -> Steps:
    return Steps(NOMINAL.space, steps)


def after(learner: Learner, steps: list[LoggedStep]) -> Learner:
    with BackgroundThread() as background:
        for logged in steps:
            background.compute(learner.pending)
            learner = learner.after(logged)
    return learner


def fitted(steps: list[LoggedStep], kind: str = DEFAULT):
    return fit_residual(kind, observe(log_of(steps), NOMINAL))


POINTS = np.random.default_rng(9).uniform([0.0, 0.54, -10, -15], [0.4, 0.62, 10, 15], (20, 4))


def test_before_a_deployment_it_has_learned_the_log() -> None:
    steps = hops(REALITY, 40, seed=0)
    learner = Learner.start(NOMINAL, log_of(steps), LearningSettings(), iteration=1)
    np.testing.assert_array_equal(learner.residual.mean(POINTS), fitted(steps).mean(POINTS))


def test_offline_nothing_is_learned_during_a_deployment() -> None:
    steps = hops(REALITY, 40, seed=0)
    learner = Learner.start(NOMINAL, log_of(steps), LearningSettings(), iteration=1)
    later = after(learner, hops(REALITY, 30, seed=1, iteration=1))
    np.testing.assert_array_equal(later.residual.mean(POINTS), learner.residual.mean(POINTS))


@pytest.mark.parametrize("kind", ["constant", "linear", "gp", "auto"])
def test_online_the_error_falls_from_hop_to_hop(kind: str) -> None:
    learner = Learner.start(NOMINAL, log_of([]), replace(ONLINE, residual=kind), iteration=0)
    truth = REALITY.evaluate(POINTS[:, :2], POINTS[:, 2:]).next_state

    def error(learner: Learner) -> Array:
        innovations = learner.step_map().evaluate(POINTS[:, :2], POINTS[:, 2:]).next_state - truth
        return np.sqrt(np.mean(innovations**2, axis=0))

    later = after(learner, hops(REALITY, 60, seed=2))
    assert (error(later) < (0.9 if kind == "constant" else 0.35) * error(learner)).all()


def test_the_newest_step_counts_for_the_next_one() -> None:
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 30, seed=0)), ONLINE, iteration=1)
    (logged,) = hops(REALITY, 1, seed=7, iteration=1)
    point = np.concatenate([logged.record.state, logged.record.applied])
    error = logged.record.next_state - NOMINAL(logged.record.state, logged.record.applied)
    expected = learner.residual.append(point, error).mean(POINTS)
    np.testing.assert_allclose(learner.after(logged).residual.mean(POINTS), expected, atol=1e-12)


def test_the_same_steps_give_the_same_model_however_long_fits_take() -> None:
    steps = hops(REALITY, 30, seed=3)
    start = Learner.start(NOMINAL, log_of([]), ONLINE, 0)
    alone = start
    for logged in steps:
        alone = alone.after(logged)
    one, other = (after(start, steps).residual.mean(POINTS) for _ in range(2))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(one, alone.residual.mean(POINTS), err_msg="without a thread")


def test_a_learner_is_immutable() -> None:
    """Two continuations of one learner change neither it nor each other."""
    start = after(
        Learner.start(NOMINAL, log_of(hops(REALITY, 30, seed=0)), ONLINE, 1), hops(REALITY, 4, 7, iteration=1)
    )
    before = start.residual.mean(POINTS)
    (one,), (other,) = (hops(reality, 1, seed=8, iteration=1, first=5) for reality in (REALITY, NOMINAL))
    futures = [start.after(logged).residual.mean(POINTS) for logged in (one, other, one)]
    np.testing.assert_array_equal(start.residual.mean(POINTS), before)
    np.testing.assert_array_equal(futures[0], futures[2])
    assert (futures[0] != futures[1]).any()
    assert (len(start.log), len(start.after(one).log)) == (34, 35)


def test_a_fit_that_is_taken_over_includes_every_step() -> None:
    """Steps were added while it was pending; the next fit begins only later."""
    known, new = hops(REALITY, 40, seed=0), hops(REALITY, 6, seed=7, iteration=1)
    learner = after(Learner.start(NOMINAL, log_of(known), ONLINE, iteration=1), new)
    for regression in learner.residual.regressions:
        assert isinstance(regression, GaussianProcessRegression)
        assert len(regression.process.points) == 46
    expected = fit_residual(DEFAULT, observe(log_of(known + new[:4]), NOMINAL), start=fitted(known))
    context = np.zeros(7)
    for logged in new[4:]:
        record = logged.record
        error = record.next_state - NOMINAL(record.state, record.applied)
        expected = expected.conditioned_on(context).append(np.concatenate([record.state, record.applied]), error)
    np.testing.assert_array_equal(learner.residual.mean(POINTS), expected.mean(POINTS))


def test_only_exploration_steps_are_learned_if_not_online() -> None:
    settings = LearningSettings("gp", exploration=12)
    start = Learner.start(NOMINAL, log_of([]), settings, iteration=0)
    steps = hops(REALITY, 12, seed=4, first=-11)
    known = after(start, steps).residual.mean(POINTS)
    np.testing.assert_allclose(known, fitted(steps, "gp").mean(POINTS), rtol=1e-3, atol=1e-5)
    later = after(start, hops(REALITY, 32, seed=4, first=-11))
    np.testing.assert_allclose(later.residual.mean(POINTS), known, atol=1e-12)


def test_a_correction_that_predicts_worse_is_not_used_until_it_is_better() -> None:
    """After a warm start two steps are enough; the drift could follow the nominal map in part, and is not estimated."""
    settings = LearningSettings(drift=False)
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 40, seed=0, iteration=-1)), settings, iteration=1)
    assert learner.step_map().residual.kind == DEFAULT
    learner = after(learner, hops(NOMINAL, 2, seed=5, iteration=1))
    assert learner.step_map().residual.kind == "none"
    learner = after(learner, hops(REALITY, 10, seed=6, iteration=1, first=3))
    assert learner.step_map().residual.kind == DEFAULT
    assert [alarm.source for alarm in learner.alarms] == ["nominal", "earlier"]


def test_a_correction_is_judged_with_its_deployed_offset() -> None:
    """The error has changed its sign: the learned residual is wrong, and the disturbance compensates for it."""
    robot, opposite = LossyHopper(drift=0.1), LossyHopper(drift=0.02)
    learner = Learner.start(NOMINAL, log_of(hops(robot, 40, seed=0)), LearningSettings(), iteration=1)
    corrected, uncorrected = [], []
    for logged in hops(opposite, 100, seed=5, iteration=1):
        record, deployed = logged.record, learner.step_map()
        learner = learner.after(logged)
        if logged.step > 30:
            corrected.append(record.next_state - deployed(record.state, record.applied))
            uncorrected.append(record.next_state - NOMINAL(record.state, record.applied))
    scale = NOMINAL.space.state_scale
    assert np.linalg.norm(corrected / scale) < 0.3 * np.linalg.norm(uncorrected / scale)


def test_steps_that_failed_are_remembered() -> None:
    (logged,) = hops(REALITY, 1, seed=0)
    failed = replace(logged, record=replace(logged.record, next_state=np.full(2, np.nan), status=StepStatus.FELL))
    learner = Learner.start(NOMINAL, log_of([failed]), LearningSettings(), iteration=1)
    np.testing.assert_array_equal(learner.failures, [[*failed.record.state, *failed.record.applied]])
    empty = Learner.start(NOMINAL, log_of([]), LearningSettings(), iteration=1)
    assert empty.failures.shape == (0, 4)
    np.testing.assert_array_equal(empty.after(failed).failures, learner.failures)


def leaning(reality: StepMap, seed: int, iteration: int) -> list[LoggedStep]:
    """Hops on a tilted boom: a sine of the yaw is added to the speed, with another zero in each deployment."""
    yaw = 10.0 * seed
    rng, steps = np.random.default_rng([seed, 1]), []
    for logged in hops(reality, 200, seed=seed, iteration=iteration):
        added = np.array([0.02 * np.sin(yaw), 0.0])
        yaw += rng.uniform(0.05, 0.35)
        record = replace(logged.record, next_state=logged.record.next_state + added, context={"yaw": yaw})
        steps.append(replace(logged, record=record))
    return steps


def test_the_yaw_dependent_part_is_not_learned_but_estimated() -> None:
    """After a known yaw; the RMS of the sine is 14 mm/s, that of the noise 4 mm/s."""
    known = leaning(REALITY, 1, 0) + leaning(REALITY, 2, 1)
    rms: dict[bool, tuple[float, float]] = {}
    for drift in (True, False):
        learner = Learner.start(
            NOMINAL, log_of(known), LearningSettings(drift=drift, remove_yaw_dependence=drift, lagged_inputs="none"), 2
        )
        points, innovations = POINTS[:, :2], []
        learned = learner.residual.mean(POINTS) - (REALITY(points, POINTS[:, 2:]) - NOMINAL(points, POINTS[:, 2:]))
        for logged in leaning(REALITY, 3, 2):
            record = logged.record
            innovations.append(record.next_state - learner.step_map()(record.state, record.applied))
            learner = learner.after(logged)
        rms[drift] = float(np.std(learned[:, 0])), float(np.std(np.array(innovations)[60:, 0]))
    assert rms[True][0] < 0.7 * rms[False][0]
    assert rms[True][1] < 0.006 < 0.013 < rms[False][1]


def test_without_a_correction_the_yaw_dependent_part_is_noise() -> None:
    """Then no disturbance is estimated, and a step scatters by it; for an exact model `auto` also selects `none`."""
    known = leaning(NOMINAL, 1, 0) + leaning(NOMINAL, 2, 1)
    errors = observe(log_of(known), NOMINAL).error
    for kind in ("none", "auto"):
        residual = Learner.start(NOMINAL, log_of(known), LearningSettings(residual=kind), 2).residual
        assert residual.kind == "none"
        np.testing.assert_allclose(residual.noise_std, np.sqrt(np.mean(errors**2, axis=0)), rtol=0.1)


def test_a_drift_within_the_deployment_is_estimated_if_wanted() -> None:
    known, shifted = hops(REALITY, 60, seed=0), np.array([0.03, -0.004])
    drifting = [
        replace(logged, record=replace(logged.record, next_state=logged.record.next_state + shifted))
        for logged in hops(REALITY, 30, seed=8, iteration=1)
    ]
    for drift in (True, False):
        learner = after(
            Learner.start(NOMINAL, log_of(known), LearningSettings(drift=drift, monitor=False), 1), drifting
        )
        added = learner.step_map().disturbance
        assert (added is not None) == drift
        np.testing.assert_allclose(added.mean(np.zeros(4)) if added else 0.0, shifted if drift else 0.0, atol=0.01)
    uncorrected = after(Learner.start(NOMINAL, log_of([]), LearningSettings(), 0), drifting)
    assert uncorrected.step_map().disturbance is None


def test_exploration_ends_at_the_step_numbered_zero_however_many_were_asked_for() -> None:
    settings = LearningSettings(exploration=12)
    explored, tracked = hops(REALITY, 3, seed=0, first=-2), hops(REALITY, 9, seed=1, first=1)
    learner = after(Learner.start(NOMINAL, log_of([]), settings, 0), [*explored, *tracked])
    assert not learner.learns
    np.testing.assert_allclose(learner.residual.mean(POINTS), fitted(explored).mean(POINTS), rtol=1e-2)
