"""The same steps give the same learner, whether it made them, was redeployed, or starts with all of them."""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from stepgap.learning.first_beliefs import LEAST_FOR_WAVES
from stepgap.learning.learner import REFIT_GROWTH, Learner
from stepgap.learning.observations import observe
from stepgap.learning.posterior import Posterior
from stepgap.learning.prior import Prior, fit_prior
from stepgap.learning.residual import Residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepMap, StepRecord, StepStatus
from tests.control.maps import LossyHopper

NOMINAL, REALITY = LossyHopper(), LossyHopper(loss=0.45, keep=0.6, drift=0.09)
NOISE = np.array([0.004, 0.001])
SCALE = NOMINAL.space.state_scale
DEFAULT = LearningSettings().residual
ONLINE = LearningSettings(online=True)


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


def log_of(steps: Iterable[LoggedStep]) -> Steps:
    return Steps(NOMINAL.space, steps)


def after(learner: Learner, steps: Iterable[LoggedStep]) -> Learner:
    for logged in steps:
        learner = learner.after(logged)
    return learner


def fitted(steps: list[LoggedStep], kind: str = DEFAULT) -> Residual:
    return fit_residual(kind, observe(log_of(steps), NOMINAL))


POINTS = np.random.default_rng(9).uniform([0.0, 0.54, -10, -15], [0.4, 0.62, 10, 15], (20, 4))


def said(learner: Learner) -> tuple[Array, Array]:
    """Next states and standard deviations of the map that plans the next step [half ranges]."""
    step_map, (state, command) = learner.step_map(), (POINTS[:, :2], POINTS[:, 2:])
    return step_map.evaluate(state, command).next_state / SCALE, step_map.std(state, command) / SCALE


def rms(learner: Learner, reality: StepMap = REALITY) -> float:
    """Error of the map that plans the next step [half ranges]."""
    truth = reality.evaluate(POINTS[:, :2], POINTS[:, 2:]).next_state / SCALE
    return float(np.sqrt(np.mean((said(learner)[0] - truth) ** 2)))


def check_same(one: Learner, other: Learner, tolerance: float = 1e-9) -> None:
    for found, expected in zip(said(one), said(other), strict=True):
        np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(one.history, other.history)
    np.testing.assert_array_equal(one.failures, other.failures)
    assert one.iteration == other.iteration


def failed(logged: LoggedStep, status: StepStatus = StepStatus.NO_TAKE_OFF) -> LoggedStep:
    return replace(logged, record=replace(logged.record, next_state=np.full(2, np.nan), status=status))


def turning(steps: Iterable[LoggedStep], seed: int, lean: float = 0.0) -> list[LoggedStep]:
    """The same on a boom whose yaw is known; if it leans, a sine of the yaw is added to the speed [m/s]."""
    rng, yaw, found = np.random.default_rng([seed, 1]), 10.0 * seed, []
    for logged in steps:
        added = np.array([lean * np.sin(yaw), 0.0])
        yaw += rng.uniform(0.05, 0.35)
        record = replace(logged.record, next_state=logged.record.next_state + added, context={"yaw": yaw})
        found.append(replace(logged, record=record))
    return found


@pytest.fixture(scope="module")
def prior() -> Prior:
    """That of hoppers that lose more or less, and drift."""
    rng, robots = np.random.default_rng(0), []
    for seed in range(30):
        hopper = LossyHopper(loss=rng.uniform(0.3, 0.6), keep=rng.uniform(0.5, 0.9), drift=rng.uniform(-0.1, 0.1))
        robots.append(observe(log_of(hops(hopper, 20, seed)), NOMINAL))
    return fit_prior(robots)


# Learning from step to step


def test_offline_the_first_deployment_is_the_nominal_map_s() -> None:
    learner = after(Learner.start(NOMINAL, log_of([]), LearningSettings(), 0), hops(REALITY, 20, seed=0))
    assert learner.beliefs is None
    np.testing.assert_allclose(said(learner)[0] * SCALE, NOMINAL(POINTS[:, :2], POINTS[:, 2:]), rtol=1e-12)
    assert len(learner.known) == 20


def test_the_next_deployment_knows_it_and_goes_on_learning() -> None:
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 30, seed=0)), LearningSettings(), 1)
    assert rms(learner) < 0.2 * rms(Learner.start(NOMINAL, log_of([]), LearningSettings(), 0))
    later = after(learner, hops(REALITY, 40, seed=1, iteration=1))
    assert rms(later) < 0.8 * rms(learner)


def test_online_the_error_falls_from_hop_to_hop(prior: Prior) -> None:
    for priors in ((), (prior,)):
        learner = Learner.start(NOMINAL, log_of([]), ONLINE, 0, priors)
        errors = [rms(learner)]
        for steps in (3, 7, 30):
            learner = after(learner, hops(REALITY, steps, seed=steps, first=len(learner.known) + 1))
            errors.append(rms(learner))
        assert errors[2] < errors[1] < errors[0] / 2
        assert errors[3] < errors[0] / 7


def test_with_a_prior_fewer_steps_are_needed(prior: Prior) -> None:
    errors = []
    for priors in ((), (prior,)):
        start = Learner.start(NOMINAL, log_of([]), ONLINE, 0, priors)
        errors.append(np.mean([rms(after(start, hops(REALITY, 6, seed))) for seed in range(5)]))
    assert errors[1] < 0.8 * errors[0]


def test_the_same_steps_give_the_same_learner() -> None:
    steps = turning(hops(REALITY, 25, seed=3), seed=1)
    one, other = (after(Learner.start(NOMINAL, log_of([]), ONLINE, 0), steps) for _ in range(2))
    check_same(one, other, tolerance=0.0)


def test_a_learner_is_immutable() -> None:
    """Two continuations of one learner change neither it nor each other."""
    known = log_of(hops(REALITY, 30, seed=0))
    start = after(Learner.start(NOMINAL, known, LearningSettings(), 1), hops(REALITY, 4, 7, iteration=1))
    before = said(start)[0]
    (one,), (other,) = (hops(reality, 1, seed=8, iteration=1, first=5) for reality in (REALITY, NOMINAL))
    futures = [said(start.after(logged))[0] for logged in (one, other, one)]
    np.testing.assert_array_equal(said(start)[0], before)
    np.testing.assert_array_equal(futures[0], futures[2])
    assert (futures[0] != futures[1]).any()
    assert (len(start.known), len(start.after(one).known)) == (34, 35)


def test_a_change_and_its_end_are_reported_with_the_numbers_of_their_steps() -> None:
    weak = LossyHopper(loss=0.45, keep=0.6, drift=0.03)
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 60, seed=0)), LearningSettings(), 1)
    for number, reality in enumerate((REALITY, weak, REALITY)):
        learner = after(learner, hops(reality, 15, seed=number, iteration=1, first=1 + 15 * number))
    assert [alarm.source for alarm in learner.alarms] == ["changed", "earlier"]
    for alarm, first in zip(learner.alarms, (16, 31), strict=True):
        assert first < alarm.step < first + 5


def test_steps_that_failed_are_remembered_but_not_learned() -> None:
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 20, seed=0)), LearningSettings(), 1)
    (logged,) = hops(REALITY, 1, seed=0, iteration=1)
    fell = learner.after(failed(logged))
    np.testing.assert_array_equal(fell.failures, [[*logged.record.state, *logged.record.requested]])
    assert fell.beliefs is not None
    assert learner.beliefs is not None
    assert fell.beliefs.beliefs is learner.beliefs.beliefs
    empty = Learner.start(NOMINAL, log_of([]), LearningSettings(), 0)
    assert empty.failures.shape == (0, 4)
    doubtful = replace(logged, record=replace(logged.record, status=StepStatus.DOUBTFUL))
    assert empty.after(doubtful).failures.shape == (0, 4), "a doubtful sensor is not due to the command"


@pytest.mark.parametrize("size", [1e300, 1e12])
def test_a_number_far_from_every_range_is_not_learned(size: float) -> None:
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 20, seed=0)), LearningSettings(), 1)
    (logged,) = hops(REALITY, 1, seed=0, iteration=1)
    wild = replace(logged, record=replace(logged.record, next_state=np.array([size, 0.5])))
    check_same(replace(learner.after(wild), history=learner.history), learner)


def test_the_first_step_of_a_plant_is_learned_without_a_judgement() -> None:
    learner = Learner.start(NOMINAL, log_of([]), ONLINE, 0)
    (logged,) = hops(LossyHopper(drift=0.3), 1, seed=0, first=0)
    unplanned = replace(logged, target=np.full(2, np.nan))
    beliefs = learner.after(unplanned).beliefs
    assert beliefs is not None
    assert learner.beliefs is not None
    np.testing.assert_array_equal(beliefs.probabilities, learner.beliefs.probabilities)
    assert not np.array_equal(said(learner.after(unplanned))[1], said(learner)[1])


def test_what_returns_with_the_yaw_is_known_in_each_deployment() -> None:
    """The RMS of the sine is 14 mm/s, that of the noise 4 mm/s; the yaw has another zero in each deployment."""
    known = [*turning(hops(REALITY, 90, 1, 0), 1, 0.02), *turning(hops(REALITY, 90, 2, 1), 2, 0.02)]
    learner, errors = Learner.start(NOMINAL, log_of(known), LearningSettings(), 2), []
    for logged in turning(hops(REALITY, 120, 3, 2), 3, 0.02):
        record = logged.record
        errors.append(record.next_state - learner.step_map()(record.state, record.requested))
        learner = learner.after(logged)
    assert np.std(np.array(errors)[60:, 0]) < 0.0065
    assert learner.alarms == ()


def test_a_wrong_measurement_moves_the_map_of_the_next_step() -> None:
    """As soon as wrong steps have proved to be wrong measurements, the next step is planned from the expected state."""
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 60, seed=0)), LearningSettings(), 1)
    state, rng, glitch = np.array([0.2, 0.58]), np.random.default_rng(5), np.array([0.3, 0.0])
    offset = np.zeros(2)
    for number in range(1, 31):
        command = rng.uniform(0.3 * NOMINAL.space.command_lower, 0.3 * NOMINAL.space.command_upper)
        wrong = number in (10, 20, 30)
        seen = state + (glitch if number in (11, 21) else 0.0)
        state = REALITY(state, command) + rng.normal(0, NOISE)
        record = StepRecord(seen, command, command, state + (glitch if wrong else 0.0), StepStatus.OK)
        learner = learner.after(LoggedStep(1, number, state, state, np.zeros(2), record))
        found = learner.step_map().offset
        assert (found is not None) == wrong, number
        offset = found if found is not None else offset
    np.testing.assert_allclose(offset, [0.3 * 2.1 / 3, 0.0], atol=0.02)
    plain = learner.step_map()
    np.testing.assert_allclose(
        plain.evaluate(POINTS[:, :2] + offset, POINTS[:, 2:]).next_state,
        replace(plain, offset=None).evaluate(POINTS[:, :2], POINTS[:, 2:]).next_state,
        rtol=1e-12,
    )
    assert learner.alarms == ()


# Deployment after deployment


def deployments(number: int, *, long: bool) -> list[list[LoggedStep]]:
    """Four of them, in the second of which a step fails and in the third the robot changes."""
    count = LEAST_FOR_WAVES // 3 + 1 if long else 13
    found = [turning(hops(REALITY, count, seed=10 * number + each, iteration=each), each) for each in range(4)]
    found[1][7] = failed(found[1][7])
    weak = LossyHopper(loss=0.45, keep=0.6, drift=0.03)
    found[2][8:] = turning(hops(weak, count - 8, seed=5, iteration=2, first=9), 5)
    return found


@pytest.mark.parametrize("case", ["", "online", "warm", "long online", "warm online"])
def test_redeployed_it_is_as_if_it_started_with_all_steps(prior: Prior, case: str) -> None:
    """Also where so many steps are known that there are more features, and after an earlier run."""
    settings, long, warm = LearningSettings(online="online" in case), "long" in case, "warm" in case
    known = log_of(hops(REALITY, 12, seed=4, iteration=-1) if warm else [])
    learner = Learner.start(NOMINAL, known, settings, 0, [prior])
    for number, steps in enumerate(deployments(1, long=long)):
        learner, known = after(learner, steps), known + steps
        learner = learner.redeployed(known, [prior])
        again = Learner.start(NOMINAL, known, settings, number + 1, [prior])
        check_same(learner, again)
        one, other = learner.beliefs, again.beliefs
        assert one is not None
        assert other is not None
        assert [each.kind for each in one.beliefs] == [each.kind for each in other.beliefs]
        np.testing.assert_allclose(one.probabilities, other.probabilities, atol=1e-12)
        assert one.features.waves == other.features.waves
        assert learner.alarms == ()


def test_a_deployment_with_a_doubtful_end_is_learned_again_without_it() -> None:
    steps = hops(REALITY, 20, seed=0)
    known = log_of([*steps[:19], replace(steps[19], record=replace(steps[19].record, status=StepStatus.DOUBTFUL))])
    learner = after(Learner.start(NOMINAL, log_of([]), ONLINE, 0), known)
    assert learner.beliefs is not None
    again = learner.redeployed(known)
    check_same(again, Learner.start(NOMINAL, known, ONLINE, 1), tolerance=0.0)
    assert not np.allclose(said(again)[0], said(learner.redeployed(log_of(steps)))[0], atol=1e-6)
    nothing = Learner.start(NOMINAL, log_of([]), ONLINE, 0)
    np.testing.assert_allclose(said(again)[0], said(nothing)[0], atol=1e-9, err_msg="all of them were doubtful")


def test_what_is_known_is_what_plans_with_the_steps_as_its_data() -> None:
    known = hops(REALITY, 25, seed=0)
    learner = Learner.start(NOMINAL, log_of(known), LearningSettings(), 1)
    learned, planned = learner.learned, learner.conditioned_residual
    assert learned.kind == planned.kind == "posterior"
    np.testing.assert_array_equal(learned.mean(POINTS), planned.mean(POINTS))
    np.testing.assert_array_equal(learned.std(POINTS), planned.std(POINTS))
    for regression in learned.regressions:
        assert len(regression.values) == 25
    for regression in planned.regressions:
        assert not len(regression.values)


def test_restored_from_files_it_goes_on() -> None:
    """What a file says as a residual of the beliefs is not added to them."""
    known = log_of(hops(REALITY, 25, seed=0))
    learner = Learner.start(NOMINAL, known, LearningSettings(), 1)
    restored = Learner.restored(NOMINAL, known, LearningSettings(), 1, learner.learned, learner.beliefs)
    check_same(restored, learner, tolerance=0.0)
    assert restored.residual.kind == "none"


def test_an_earlier_run_is_believed_as_long_as_it_predicts(prior: Prior) -> None:
    """That of the same robot is as good as known steps; that of another one is soon forgotten."""
    other = LossyHopper(push=-0.02, drift=0.15)
    steps, errors = hops(REALITY, 6, seed=3), dict[str, float]()
    for name, run in (("none", []), ("same", hops(REALITY, 30, 5, -1)), ("other", hops(other, 30, 6, -1))):
        learner = Learner.start(NOMINAL, log_of(run), ONLINE, 0, [prior])
        errors[name] = rms(after(learner, steps))
    assert errors["same"] < 0.6 * errors["none"]
    assert errors["other"] < 1.2 * errors["none"]


# Other residuals


@pytest.mark.parametrize("kind", ["constant", "quadratic", "gp"])
def test_another_residual_is_the_mean_of_beliefs(kind: str) -> None:
    """Its noise is theirs, and they follow the robot where it cannot."""
    known = hops(REALITY, 40, seed=0)
    learner = Learner.start(NOMINAL, log_of(known), LearningSettings(kind), 1)
    residual = fitted(known, kind)
    expected = NOMINAL(POINTS[:, :2], POINTS[:, 2:]) + residual.mean(POINTS)
    np.testing.assert_allclose(said(learner)[0] * SCALE, expected, rtol=1e-12)
    assert (said(learner)[1] * SCALE >= residual.std(POINTS)).all()
    assert learner.learned.kind == kind
    for regression, fit in zip(learner.conditioned_residual.regressions, residual.regressions, strict=True):
        assert isinstance(regression, Posterior)
        assert regression.base is not None
        np.testing.assert_array_equal(regression.base.mean(POINTS), fit.mean(POINTS))
    shifted = LossyHopper(loss=0.45, keep=0.6, drift=0.05)
    later = after(learner, hops(shifted, 40, seed=4, iteration=1))
    assert rms(later, shifted) < 0.5 * rms(learner, shifted)
    np.testing.assert_array_equal(later.residual.mean(POINTS), learner.residual.mean(POINTS))


@pytest.mark.parametrize("kind", ["linear", "gp", "posterior"])
def test_without_drift_the_residual_is_alone_to_the_last_bit(kind: str) -> None:
    known, settings = hops(REALITY, 40, seed=0), LearningSettings(kind, drift=False)
    learner = Learner.start(NOMINAL, log_of(known), settings, 1)
    assert learner.beliefs is None
    residual = fitted(known, kind)
    for one in (learner, after(learner, hops(REALITY, 10, seed=1, iteration=1))):
        found = one.conditioned_residual
        assert found.kind == kind
        for name in ("mean", "std", "mean_gradient", "std_gradient"):
            np.testing.assert_array_equal(getattr(found, name)(POINTS), getattr(residual, name)(POINTS))
        assert one.step_map().offset is None


def test_online_a_residual_alone_is_appended_to_and_fitted_again_when_it_has_grown() -> None:
    settings = LearningSettings("gp", online=True, drift=False)
    known, new = hops(REALITY, 40, seed=0), hops(REALITY, 6, seed=7, iteration=1)
    learner, expected = Learner.start(NOMINAL, log_of(known), settings, 1), fitted(known, "gp")
    for number, logged in enumerate(new, 1):
        learner, record = learner.after(logged), logged.record
        if 40 + number > REFIT_GROWTH * len(expected.regressions[0].points):
            expected = fitted(known + new[:number], "gp")
            assert number == 5
        elif number < 5:
            error = record.next_state - NOMINAL(record.state, record.requested)
            assert len(learner.residual.regressions[0].points) == 40 + number
            appended = learner.residual.mean(POINTS) - expected.mean(POINTS)
            assert np.abs(appended).max() > 0
            point = np.concatenate([record.state, record.requested])
            grown = after(Learner.start(NOMINAL, log_of(known), settings, 1), new[: number - 1]).residual
            np.testing.assert_allclose(learner.residual.mean(POINTS), grown.append(point, error).mean(POINTS))
    assert len(learner.residual.regressions[0].points) == 46


@pytest.mark.parametrize("kind", ["none", "auto"])
def test_where_nothing_is_learned_a_step_scatters_by_its_noise(kind: str) -> None:
    known = hops(NOMINAL, 60, seed=0)
    learner = Learner.start(NOMINAL, log_of(known), LearningSettings(kind, drift=False), 1)
    assert learner.residual.kind == "none"
    errors = observe(log_of(known), NOMINAL).error
    np.testing.assert_allclose(learner.residual.noise_std, np.sqrt(np.mean(errors**2, axis=0)), rtol=0.1)


def test_no_residual_has_no_beliefs() -> None:
    learner = Learner.start(NOMINAL, log_of(hops(REALITY, 20, seed=0)), LearningSettings("none"), 1)
    assert after(learner, hops(REALITY, 5, seed=1, iteration=1)).beliefs is None


def test_exploratory_steps_are_learned_from_the_first_one_on() -> None:
    settings = LearningSettings(exploration=12)
    learner = Learner.start(NOMINAL, log_of([]), settings, 0)
    assert learner.beliefs is not None
    explored = after(learner, hops(REALITY, 12, seed=0, first=-11))
    assert rms(explored) < 0.3 * rms(learner)
