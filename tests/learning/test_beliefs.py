"""Beliefs compete as Bayes' rule says, and mistake neither a wrong step for a change nor a change for a wrong step.

Robots and errors are in half ranges; the noise of a step is 0.03.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import multivariate_normal, multivariate_t

from stepgap.gauss.weights import Weights
from stepgap.learning.belief import Belief
from stepgap.learning.beliefs import (
    CHANGED_PART,
    FIRST_HAZARD,
    LEAST_WEIGHT,
    MOST,
    RUN_COUNT,
    WRONG,
    WRONG_FREEDOM,
    WRONG_WIDTH,
    YOUNG,
    Beliefs,
    Observed,
    Suspicion,
)
from stepgap.learning.first_beliefs import (
    EXPECTED_NOISE_COUNT,
    LEAST_FOR_WAVES,
    MOST_MONOMIALS,
    PERIODIC_STD,
    RIVAL,
    WAVES,
    Family,
    features_of,
    first_beliefs,
)
from stepgap.step import Array
from tests.learning.robots import (
    FAMILY,
    FEATURES,
    NOISE,
    POINTS,
    SIZES,
    Robot,
    begun,
    changed,
    drawn,
    kinds,
    known,
    rms,
)

COUNT = FEATURES.count
SIZE = COUNT + 2 + 4
PLACES = [COUNT, COUNT + 1]
"""Of the weights of the periodic part."""


def random_belief(seed: int, freedom: float = 8.0, **others: Any) -> Belief:
    rng = np.random.default_rng([seed, 3])
    roots = 0.1 * rng.normal(size=(2, SIZE, SIZE))
    weights = Weights.of_moments(
        0.3 * rng.normal(size=(2, SIZE)), roots @ np.swapaxes(roots, 1, 2) + 1e-3 * np.eye(SIZE)
    )
    freedoms = np.full(2, freedom)
    return replace(
        Belief("unknown", weights, freedoms, (freedom - 2) * np.array([0.03, 0.05]) ** 2, 0.0, age=5), **others
    )


def holding(beliefs: Sequence[Belief]) -> Beliefs:
    """Beliefs from which no changed one is born in the next step."""
    return replace(begun(), beliefs=tuple(beliefs), recent=np.empty((0, SIZE)))


def after(beliefs: Beliefs, robot: Robot, steps: int, **wrong: Any) -> Beliefs:
    for _ in range(steps):
        beliefs = beliefs.after(robot.step(**wrong))
    return beliefs


def settled(seed: int, steps: int = 40) -> tuple[Beliefs, Robot]:
    """Beliefs that know a robot, and the robot."""
    robot = Robot(drawn(seed), seed)
    return after(begun(FAMILY), robot, steps), robot


def share(beliefs: Beliefs, *wanted: str) -> float:
    """Probability of the beliefs of some kinds."""
    return float(sum(p for kind, p in zip(kinds(beliefs), beliefs.probabilities, strict=True) if kind in wanted))


def log_odds(beliefs: Beliefs, kind: str) -> float:
    return float(np.log(share(beliefs, kind) / (1 - share(beliefs, kind))))


# Bayes' rule


def student(error: Array, variance: Array, freedom: float) -> float:
    return float(multivariate_t.pdf(error, None, np.diag(variance), freedom))  # pyright: ignore[reportArgumentType]


def expected_density(belief: Belief, features: Array, error: Array, wide: Array) -> float:
    """Of a step that is regular or wrong."""
    mean, variance = belief.weights.predicted(features)
    freedom = float(belief.freedom[0])
    spread = (variance + belief.noise) * (freedom - 2) / freedom
    return (1 - WRONG) * student(error - mean, spread, freedom) + WRONG * student(error - mean, wide, WRONG_FREEDOM)


@pytest.mark.parametrize("size", [0.0, 0.1, 1.0, 30.0])
def test_a_step_multiplies_each_weight_by_the_density_of_its_error(size: float) -> None:
    one, other = random_belief(0, log_weight=np.log(0.3)), random_belief(1, log_weight=np.log(0.7), kind="run")
    beliefs, step = holding([one, other]), Robot(drawn(0)).step()
    step = replace_error(step, size * np.array([1.0, -0.4]))
    features = beliefs.all_features(step.point, beliefs.side(step.phase))
    totals = [each.weights.predicted(features).variance + each.noise for each in (one, other)]
    wide = np.maximum(np.max(totals, axis=0), WRONG_WIDTH**2 * other.noise)
    densities = [expected_density(each, features, step.error, wide) for each in (one, other)]
    expected = np.log(0.7 * densities[1] / (0.3 * densities[0]))
    assert log_odds(beliefs.after(step), "run") == pytest.approx(expected, abs=1e-8)


def replace_error(step: Observed, error: Array) -> Observed:
    return step._replace(error=error)


def test_after_many_steps_the_weights_are_those_of_exact_bayes() -> None:
    """The density of all errors at once is normal where the noise is known; wrong steps do not occur."""
    robot = Robot(drawn(0))
    one, other = (random_belief(seed, 1e7) for seed in (0, 1))
    one = replace(one, weights=replace(one.weights, mean=np.pad(robot.weights, ((0, 0), (0, SIZE - 15)))))
    other = replace(other, weights=replace(other.weights, mean=one.weights.mean + 0.01), kind="run")
    beliefs, steps, rows = holding([one, other]), [robot.step() for _ in range(12)], []
    for step in steps:
        rows.append(beliefs.all_features(step.point, beliefs.side(step.phase)))
        beliefs = replace(beliefs.after(step), recent=np.empty((0, SIZE)))
    features, errors = np.array(rows), np.array([step.error for step in steps])

    def log_density(belief: Belief) -> float:
        covariances = features @ belief.weights.covariance @ features.T + belief.noise[:, None, None] * np.eye(12)
        means = features @ belief.weights.mean.T
        return sum(float(multivariate_normal.logpdf(errors[:, n], means[:, n], covariances[n])) for n in range(2))

    assert log_odds(beliefs, "run") == pytest.approx(log_density(other) - log_density(one), abs=0.1)
    assert beliefs.alarm is None


def test_a_step_after_a_wrong_measurement_has_a_third_explanation() -> None:
    """It began where the step before was predicted to end; the offset is known up to the variance of that."""
    one, other = random_belief(0), random_belief(1, kind="run")
    doubt = Suspicion(1.0, 0.4, offset := np.array([0.9, -0.2]), variance := np.array([0.01, 0.02]), 1)
    beliefs, step = replace(holding([one, other]), suspicion=doubt, before=np.full(4, 0.1)), Robot(drawn(0)).step()
    features = beliefs.all_features(step.point, beliefs.side(step.phase))
    point, error, slope = step.from_elsewhere(offset) or pytest.fail("there is a nominal map")
    unknown = np.array([0, 0, 0, 0, 0.1, 0.1])  # the error before is not known, its command is
    moved, noise = beliefs.all_features(point, unknown), slope**2 @ variance
    totals = [each.weights.predicted(features).variance + each.noise for each in (one, other)]
    wide = np.maximum(np.max(totals, axis=0), WRONG_WIDTH**2 * one.noise)

    def density(belief: Belief) -> float:
        mean, spread = belief.weights.predicted(moved)
        elsewhere = student(error - mean, (spread + belief.noise + noise) * 6 / 8, 8)
        here = expected_density(belief, features, step.error, wide)
        mean, spread = belief.weights.predicted(features)
        return here + 0.4 * (elsewhere - student(step.error - mean, (spread + belief.noise) * 6 / 8, 8))

    expected = np.log(density(other) / density(one))
    assert log_odds(beliefs.after(step), "run") == pytest.approx(expected, abs=1e-6)


def test_before_the_first_step_the_rivals_of_what_is_expected_have_little_weight() -> None:
    two = begun(FAMILY, FAMILY)
    assert share(two, "family") == pytest.approx((1 - 2 * RIVAL) / (1 + RIVAL))
    assert share(two, "unknown") == pytest.approx(2 * RIVAL / (1 + RIVAL))
    assert share(two, "nominal") == pytest.approx(RIVAL / (1 + RIVAL))
    alone = begun()
    assert set(kinds(alone)) == {"unknown", "nominal"}
    assert share(alone, "nominal") == pytest.approx(RIVAL / (1 - RIVAL))
    fitted = Beliefs.start(FEATURES, SIZES, (), np.array([0.02, 0.05]))
    assert set(kinds(fitted)) == {"fitted", "unknown"}
    np.testing.assert_allclose(fitted.beliefs[0].noise, [0.02**2, 0.05**2])
    for beliefs in (two, alone, fitted):
        mean, std = known(beliefs)
        np.testing.assert_array_equal(mean, 0.0)
        assert (std > 0).all()


def test_a_change_adds_a_part_of_what_robots_differ_by() -> None:
    family, fitted = begun(FAMILY), Beliefs.start(FEATURES, SIZES, (), np.full(2, NOISE))
    np.testing.assert_allclose(family.change[:, :15, :15], CHANGED_PART * FAMILY.covariance)
    wide = fitted.beliefs[kinds(fitted).index("unknown")].weights.covariance
    np.testing.assert_allclose(fitted.change, CHANGED_PART * wide, err_msg="not of what is left by a fit that is right")


# Few beliefs, of which none is lost


def test_beliefs_that_predict_the_same_become_one() -> None:
    beliefs, robot = settled(0)
    best = replace(beliefs.beliefs[0], log_weight=0.0, age=20)
    weights = replace(best.weights, mean=best.weights.mean + 1e-4)
    twins = [
        replace(best, kind="run", log_weight=-1.0),
        replace(best, weights=weights, log_weight=-2.0, kind="changed"),
    ]
    found = replace(beliefs, beliefs=(best, *twins)).after(robot.step())
    assert [kind for kind in kinds(found) if kind in ("run", best.kind)] == [best.kind]
    assert found.probabilities[0] > 0.99, "it has the probability of all"


def test_what_was_believed_earlier_and_another_rate_stay_apart() -> None:
    beliefs, robot = settled(0)
    best = replace(beliefs.beliefs[0], log_weight=0.0, rate=0.0)
    twins = replace(best, kind="earlier", log_weight=-1.0), replace(best, rate=0.1, log_weight=-1.0)
    found = replace(beliefs, beliefs=(best, *twins)).after(robot.step())
    assert "earlier" in kinds(found)
    assert {each.rate for each in found.beliefs if each.kind == best.kind} == {0.0, 0.1}


def test_few_beliefs_are_kept_but_none_that_is_young() -> None:
    """There are more that say different things, each for its own constant; the youngest ones are the least probable."""
    beliefs, robot = settled(0)
    best = replace(beliefs.beliefs[0], log_weight=0.0, age=50)
    others = []
    for number in range(1, 20):
        mean = best.weights.mean.copy()
        mean[:, 0] += 0.4 * number
        age = number - 15 if number > 15 else 50
        others.append(replace(best, weights=replace(best.weights, mean=mean), log_weight=-number, age=age, kind="run"))
    found = replace(beliefs, beliefs=(best, *others)).after(robot.step())
    ages = [each.age for each in found.beliefs]
    assert len([age for age in ages if age > YOUNG]) <= MOST
    assert sorted(age for age in ages if age <= YOUNG) == [1, 2, 3], "a newborn one, and those of 2 and 3 steps"


# Wrong steps


@pytest.mark.parametrize("size", [0.6, 3.0, 100.0, 1e5])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_single_large_error_is_not_learned_and_no_change(size: float, seed: int) -> None:
    beliefs, robot = settled(seed)
    before = known(beliefs)[0]
    pushed = beliefs.after(robot.step(push=size * np.array([1.0, -0.5])))
    assert pushed.alarm is None
    assert pushed.suspicion is not None
    assert pushed.suspicion.wrong > 0.9
    assert np.abs(known(pushed)[0] - before).max() < 0.03
    noise = beliefs.mixture(np.nan).noise
    np.testing.assert_allclose(pushed.mixture(np.nan).noise, noise, rtol=0.3)
    robot.state = robot.measured = np.zeros(2)  # where it stands after it, does not matter
    for _ in range(15):
        pushed = pushed.after(robot.step())
        assert pushed.alarm is None
    assert rms(pushed, robot) < 0.035


def test_the_step_after_a_wrong_measurement_is_explained_from_the_predicted_state() -> None:
    """The first one is taken for a push in the plan; from the second one on, the plan begins at the predicted state."""
    beliefs, robot = settled(1)
    glitch, shares = np.array([1.5, -1.0]), []
    for _ in range(4):
        wrong = beliefs.after(robot.step(glitch=glitch))
        assert wrong.suspicion is not None
        np.testing.assert_allclose(wrong.suspicion.offset, glitch, atol=0.2)
        planned = wrong.mixture(np.nan).offset
        np.testing.assert_allclose(planned, wrong.suspicion.measured_wrongly * wrong.suspicion.offset)
        shares.append(wrong.suspicion.measured_wrongly)
        counts = wrong.wrong_measurements
        beliefs = wrong.after(robot.step())
        assert beliefs.wrong_measurements[0] - counts[0] > 0.9
        assert beliefs.suspicion is None, "this step was as regular as any other"
        for _ in range(8):
            assert not beliefs.mixture(np.nan).offset.any()
            beliefs = beliefs.after(robot.step())
            assert beliefs.alarm is None
    assert shares[0] == pytest.approx(0.1, abs=0.01)
    assert shares[1] == pytest.approx(0.55, abs=0.02)
    assert shares[3] > 0.75
    assert rms(beliefs, robot) < 0.035


def test_after_pushes_the_plan_begins_at_the_measured_state() -> None:
    beliefs, robot = settled(1)
    for _ in range(4):
        beliefs = beliefs.after(robot.step(push=[0.8, -0.5]))
        assert beliefs.suspicion is not None
        beliefs = after(beliefs, robot, 6)
    wrong = beliefs.after(robot.step(push=[0.8, -0.5])).suspicion
    assert wrong is not None
    assert wrong.measured_wrongly < 0.05


def test_two_per_cent_of_wrong_measurements_are_no_changes() -> None:
    robot, rng = Robot(drawn(3), 3), np.random.default_rng(5)
    beliefs, alarms = begun(), 0
    for number in range(150):
        glitch = (
            rng.choice([-1, 1]) * rng.uniform(1, 3) * np.eye(2)[rng.integers(2)] if number % 40 == 20 else np.zeros(2)
        )
        beliefs = beliefs.after(robot.step(glitch=glitch))
        alarms += beliefs.alarm is not None
    assert alarms == 0
    assert rms(beliefs, robot) < 0.03


# Changes


@pytest.mark.parametrize("families", [(), (FAMILY,)], ids=["nothing known", "family"])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_changed_robot_is_found_after_two_or_three_steps_and_so_is_its_end(
    families: Sequence[Family], seed: int
) -> None:
    robot = Robot(original := drawn(seed), seed)
    beliefs = after(begun(*families), robot, 40)
    right = rms(beliefs, robot)
    for weights, kind, most in ((changed(original), "changed", 3), (original, "earlier", 3)):
        robot.weights = weights
        alarms = []
        for number in range(1, 16):
            beliefs = beliefs.after(robot.step())
            alarms += [(number, beliefs.alarm)] if beliefs.alarm else []
        assert [alarm for _, alarm in alarms] == [kind]
        assert alarms[0][0] <= most
        assert "current" in kinds(beliefs)
    assert rms(beliefs, robot) < right + 0.01, "what was known before was not forgotten"


def siblings(beliefs: Beliefs) -> Beliefs:
    """After a false alarm: newborn beliefs that have become equally good, and hold all places."""
    best = replace(beliefs.beliefs[0], kind="current", log_weight=0.0, age=90)
    others = []
    for number in range(1, MOST + 4):
        mean = best.weights.mean + 1e-3 * np.random.default_rng(number).normal(size=(2, SIZE))
        weights = replace(best.weights, mean=mean)
        others.append(replace(best, weights=weights, kind="changed", log_weight=-2.6 - 0.1 * number, age=90 - number))
    return replace(beliefs, beliefs=(best, *others))


def steps_until_found(beliefs: Beliefs, robot: Robot) -> int:
    """Number of steps after which a change is reported, at most 12."""
    for number in range(1, 13):
        beliefs = beliefs.after(robot.step())
        if beliefs.alarm:
            return number
    return 12


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_change_after_a_false_alarm_is_found(seed: int) -> None:
    beliefs, robot = settled(seed)
    robot.weights = changed(robot.weights)
    assert steps_until_found(siblings(beliefs), robot) <= 3


def largest_row(robot: Robot, beliefs: Beliefs, wanted: float, steps: int) -> int:
    """Longest row of steps in which some error exceeds `wanted`, from states within the range of use."""
    row = longest = 0
    for _ in range(steps):
        robot.state = robot.measured = robot.rng.uniform(-0.8, 0.8, 2)
        step = robot.step()
        features = beliefs.all_features(step.point, beliefs.side(step.phase))
        error = step.error - beliefs.mixture(np.nan).mean @ features
        row = row + 1 if np.abs(error).max() > wanted else 0
        longest = max(longest, row)
        beliefs = beliefs.after(step)
    return longest


@pytest.mark.parametrize("families", [(), (FAMILY,)], ids=["nothing known", "family"])
@pytest.mark.parametrize("size", [0.25, 0.75, 1.5, 3.0])
def test_large_errors_never_last(families: Sequence[Family], size: float) -> None:
    """Nor if robots of the family differ by much less, here a standard deviation of 0.15."""
    for seed in range(2):
        robot = Robot(original := drawn(seed), seed)
        beliefs = after(begun(*families), robot, 30)
        robot.weights = changed(original, (size, -0.6 * size))
        assert largest_row(robot, beliefs, max(5 * NOISE, 0.3 * size), 20) <= 7


@pytest.mark.parametrize("seed", range(3))
def test_nor_after_several_changes_and_pushes(seed: int) -> None:
    robot = Robot(original := drawn(seed), seed)
    beliefs, rng = begun(*([FAMILY] if seed % 2 else [])), np.random.default_rng([seed, 7])
    for _ in range(4):
        for number in range(30):
            push = rng.choice([-1, 1], 2) * [0.8, 0.5] if number in (7, 19) else [0.0, 0.0]
            beliefs = beliefs.after(robot.step(push=push))
        robot.weights = original if rng.random() < 0.3 else changed(original, rng.choice([-1, 1], 2) * [0.3, 0.2])
        assert largest_row(robot, beliefs, 5 * NOISE, 12) <= 4


def test_after_a_change_neither_bounds_nor_pushes_make_the_nominal_map_plan() -> None:
    """The nominal map is a belief with a small weight beforehand, never a refuge."""
    robot = Robot(changed(drawn(4), (0.5, 0.4)), 4)
    beliefs = after(begun(FAMILY), robot, 40)
    robot.weights = changed(robot.weights)
    beliefs = after(beliefs, robot, 5)
    corners, rng = np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]]), np.random.default_rng(0)
    for number in range(40):
        push = rng.choice([-1, 1], 2) * [0.7, 0.9] if number % 4 == 3 else [0.0, 0.0]
        beliefs = beliefs.after(robot.step(corners[number % 4], push=push))
        assert share(beliefs, "nominal") < LEAST_WEIGHT / 10
        assert np.abs(known(beliefs)[0][:, 0].mean() - robot.error()[:, 0].mean()) < 0.2
        np.testing.assert_array_less(0.3, known(beliefs)[0][:, 0].mean())


def test_a_belief_that_becomes_the_best_slowly_is_no_change() -> None:
    beliefs, robot = settled(0)
    best = replace(beliefs.beliefs[0], log_weight=-8.0)
    mean = best.weights.mean.copy()
    mean[:, 0] += 0.1
    worse = replace(best, weights=replace(best.weights, mean=mean), log_weight=0.0)
    old, new = (replace(best, kind="changed", age=age) for age in (30, 2))
    for better, alarm in ((old, None), (new, "changed")):
        found, alarms = replace(beliefs, beliefs=(worse, better)), []
        for _ in range(6):
            found = found.after(robot.step())
            alarms += [found.alarm] if found.alarm else []
        assert alarms == ([alarm] if alarm else [])
        assert found.beliefs[0].kind == "current", "it is taken over all the same"
        assert ("earlier" in kinds(found)) == (alarm is not None)


# What is known beforehand


def inverted(seed: int) -> Array:
    """Weights of the robot whose commands act as if they were inverted, at least in part."""
    weights = drawn(seed)
    weights[[0, 1], [3, 4]] -= 0.9
    return weights


def run_of(robot: Robot, steps: int = 40) -> list[tuple[Observed, bool]]:
    return [(robot.step(), number > 0) for number in range(steps)]


def test_an_earlier_run_of_the_same_robot_is_known_at_once() -> None:
    robot = Robot(drawn(0), 0)
    warm = begun(FAMILY).with_runs([run_of(robot)])
    assert share(warm, "run") == pytest.approx(1 / 2, abs=0.01)
    cold = begun(FAMILY)
    for _ in range(3):
        step = robot.step()
        warm, cold = warm.after(step), cold.after(step)
    assert rms(warm, robot) < 0.03 < 0.5 * rms(cold, robot)
    assert share(warm, "run") > 0.9


def test_a_run_is_worth_no_more_steps_than_its_noise_may_be() -> None:
    warm = begun(FAMILY).with_runs([run_of(Robot(drawn(0), 0), 90), run_of(Robot(drawn(1), 1), 20)])
    long, short = warm.beliefs[-2:]
    np.testing.assert_array_equal(long.freedom, RUN_COUNT)
    assert (short.freedom < EXPECTED_NOISE_COUNT + 20.1).all()
    for run in (long, short):
        np.testing.assert_allclose(np.sqrt(run.noise), NOISE, rtol=0.4)
    assert share(warm, "run") == pytest.approx(1 / 2, abs=0.02), "all runs as much as all that is expected"
    np.testing.assert_allclose(warm.probabilities[-2:], share(warm, "run") / 2)


def test_a_wrong_run_and_the_family_are_averaged_and_the_plan_knows_where_they_disagree() -> None:
    """The run is of inverted commands: at the bounds of a command half the difference is uncertainty."""
    robot, wrong = Robot(drawn(2), 2), Robot(inverted(2), 2)
    beliefs = begun(FAMILY).with_runs([run_of(wrong)])
    middle, bound = np.zeros(4), np.array([0.0, 0.0, 1.0, 1.0])
    mean, std = known(beliefs, np.array([middle, bound]))
    said = wrong.error(bound[None])[0]
    np.testing.assert_allclose(mean[1], said / 2, atol=0.1)
    assert (std[1] > 0.45 * np.abs(said)).all(), "half of the difference to the family, which expects zero"
    assert (std[1] > 2 * std[0]).all()
    for _ in range(4):
        beliefs = beliefs.after(robot.step())
    assert share(beliefs, "run") < 0.01
    cold, robot = begun(FAMILY), Robot(drawn(2), 2)
    assert rms(beliefs, robot) < 1.2 * rms(after(cold, robot, 4), robot)


@pytest.mark.parametrize(("weight", "plans"), [(0.02, True), (0.011, True), (0.005, False)])
def test_a_belief_of_one_or_two_per_cent_still_plans(weight: float, plans: bool) -> None:
    """A belief that is surer and wrong must not plan alone before it has been tested."""
    sure, other = random_belief(0, log_weight=np.log(1 - weight)), random_belief(1, log_weight=np.log(weight))
    mixture, shares = holding([sure, other]).mixture(np.nan), (1 - weight, weight) if plans else (1.0, 0.0)
    mean = shares[0] * sure.weights.mean + shares[1] * other.weights.mean
    np.testing.assert_allclose(mixture.mean, mean, rtol=1e-9)
    square = sum(
        part * (each.weights.covariance + each.weights.mean[:, :, None] * each.weights.mean[:, None, :])
        for part, each in zip(shares, (sure, other), strict=True)
    )
    np.testing.assert_allclose(mixture.covariance, square - mean[:, :, None] * mean[:, None, :], atol=1e-9)
    np.testing.assert_allclose(mixture.noise, shares[0] * sure.noise + shares[1] * other.noise)


def test_standing_still_says_nothing_about_a_motion_never_seen() -> None:
    """Nor does any belief take over there that is surer of it."""
    robot = Robot(drawn(5), 5)
    beliefs, far = begun(FAMILY), np.array([[0.8, -0.5, 0.8, -0.8]])
    before = known(beliefs, far)[1]
    hold = np.zeros(2)
    for _ in range(60):
        robot.state = robot.measured = 0.02 * robot.rng.standard_normal(2)
        beliefs = beliefs.after(robot.step(hold + 0.02 * robot.rng.standard_normal(2)))
    mean, std = known(beliefs, far)
    # exactly known at rest is the constant alone
    features = FEATURES(far)[0, 1:15]
    least = np.sqrt(features**2 @ np.diagonal(FAMILY.covariance, axis1=1, axis2=2)[:, 1:15].T)
    assert (std > 0.9 * least).all()
    assert (std < 1.1 * before).all()
    assert (np.abs(mean - robot.error(far)) < 3 * std).all()
    assert known(beliefs, np.zeros((1, 4)))[1].max() < 0.015


# Between steps and deployments


def test_another_deployment_forgets_the_zero_of_the_phase_and_what_was_earlier() -> None:
    robot = Robot(drawn(0), 0)
    beliefs, angle = begun(FAMILY), 0.0
    for number in range(60):
        if number == 40:
            robot.weights = changed(robot.weights)
        angle += robot.rng.uniform(0.1, 0.5)
        step = robot.step(phase=angle)
        beliefs = beliefs.after(step._replace(error=step.error + np.array([0.05 * np.sin(angle), 0.0])))
    wrong = beliefs.after(robot.step(phase=angle, glitch=[2.0, 0.0]))
    assert "earlier" in kinds(wrong)
    assert np.abs(wrong.beliefs[0].weights.mean[0, PLACES]).max() > 0.02
    fresh = wrong.redeployed()
    assert "earlier" not in kinds(fresh)
    assert fresh.suspicion is None
    assert not fresh.before.any()
    assert not fresh.mixture(1.0).offset.any()
    old = [each for each in wrong.beliefs if each.kind != "earlier"]
    for one, other in zip(old, fresh.beliefs, strict=False):
        np.testing.assert_array_equal(other.weights.mean[:, PLACES], 0.0)
        covariance, others = other.weights.covariance, np.delete(np.arange(SIZE), PLACES)
        for n in range(2):
            expected = PERIODIC_STD**2 * one.noise[n] * np.eye(2)
            np.testing.assert_allclose(covariance[n][np.ix_(PLACES, PLACES)], expected, atol=1e-15)
            same = one.weights.covariance[n][np.ix_(others, others)]
            same[0, 0] += one.noise[n]  # the constant of a deployment is a little another one
            np.testing.assert_allclose(covariance[n][np.ix_(others, others)], same, atol=1e-15)
    last, best = fresh.beliefs[-1], fresh.beliefs[0]
    assert (last.kind, last.age, last.rate) == ("changed", 0, 0.0)
    assert last.log_weight == pytest.approx(np.log(FIRST_HAZARD))
    np.testing.assert_allclose(last.weights.covariance, best.weights.covariance + fresh.change)


def test_an_effect_that_comes_a_step_late_is_learned() -> None:
    """A quarter of the command before, which is noise for a belief that does not look back."""
    robot = Robot(drawn(0), 0)
    robot.late = 0.25
    beliefs, errors = begun(FAMILY), list[Array]()
    for _ in range(120):
        step = robot.step()
        features = beliefs.all_features(step.point, beliefs.side(np.nan))
        errors.append(step.error - beliefs.mixture(np.nan).mean @ features)
        beliefs = beliefs.after(step)
    assert np.std(errors[60:]) < 1.4 * NOISE < np.hypot(NOISE, 0.25 / np.sqrt(3)) / 3, "the effect is uniform"
    assert (np.diag(beliefs.mixture(np.nan).mean[:, -2:]) > 0.15).all(), "of 0.25, five prior deviations"


def test_after_a_step_without_an_error_nothing_is_known_of_the_step_before() -> None:
    beliefs, robot = settled(0)
    wrong = beliefs.after(robot.step(glitch=[2.0, 0.0]))
    assert wrong.before.any()
    unlinked = wrong.unlinked()
    assert (unlinked.suspicion, unlinked.alarm, unlinked.before.any()) == (None, None, False)
    assert unlinked.beliefs is wrong.beliefs


def test_a_first_step_of_a_plant_is_learned_but_not_judged() -> None:
    beliefs, robot = begun(FAMILY), Robot(drawn(0), 0)
    taught = beliefs.taught(robot.step(push=[0.5, 0.0]))
    assert kinds(taught) == kinds(beliefs)
    np.testing.assert_array_equal(taught.probabilities, beliefs.probabilities)
    assert known(taught)[1].mean() < known(beliefs)[1].mean()


def test_the_phase_of_a_step_is_in_its_features() -> None:
    beliefs = begun()
    np.testing.assert_allclose(beliefs.side(0.3)[:2], [np.sin(0.3), np.cos(0.3)])
    np.testing.assert_array_equal(beliefs.side(np.nan), np.zeros(6))
    np.testing.assert_array_equal(beliefs.mixture(0.3).side, beliefs.side(0.3))


def test_features_grow_with_the_steps_and_shrink_with_the_inputs() -> None:
    """Waves say nothing before many steps are known, and no deployment tells the weights of many monomials apart."""
    for inputs in (4, 15, 16, 40):
        features = features_of(inputs, LEAST_FOR_WAVES)
        assert features.inputs == inputs
        assert features.waves == WAVES
        assert features.degree == (2 if (inputs + 1) * (inputs + 2) // 2 <= MOST_MONOMIALS else 1)
    assert features_of(4, LEAST_FOR_WAVES - 1).waves == 0
    one, other = features_of(4, 1000), features_of(4, LEAST_FOR_WAVES)
    np.testing.assert_array_equal(one.frequencies, other.frequencies)
    np.testing.assert_array_equal(one.shifts, other.shifts)


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.floats(-6, 6))
def test_errors_of_any_size_leave_beliefs_that_can_plan(seed: int, largest: float) -> None:
    rng = np.random.default_rng(seed)
    beliefs, robot = begun(FAMILY), Robot(drawn(0), 0)
    for number in range(25):
        step = robot.step()
        factor = 10 ** rng.uniform(min(0, largest), max(0, largest))
        beliefs = beliefs.after(step._replace(error=factor * rng.normal(size=2)))
        if number == 12:
            beliefs = beliefs.redeployed()
        assert beliefs.probabilities.sum() == pytest.approx(1.0)
        for each in beliefs.beliefs:
            assert np.isfinite(each.log_weight)
            assert (each.noise > 0).all()
            assert (np.diagonal(each.weights.root, axis1=1, axis2=2) > 0).all()
    mean, std = known(beliefs, POINTS)
    assert np.isfinite(mean).all()
    assert (std > 0).all()


def test_what_is_not_known_of_a_robot_with_a_lag_stays_within_its_range() -> None:
    """Its error in a corner of all ranges; of other robots it may be more than three half ranges."""
    features = features_of(6, LEAST_FOR_WAVES)
    corner = features(np.ones(6))[: features.monomials]

    def largest(lagged: bool) -> float:
        unknown = [belief for belief in first_beliefs(features, (3, 3), (), None, lagged) if belief.kind == "unknown"]
        size = features.monomials
        covariances = [belief.weights.covariance[0, :size, :size] for belief in unknown]
        return float(np.sqrt(max(corner @ covariance @ corner for covariance in covariances)))

    assert largest(lagged=True) < 1.0
    assert largest(lagged=False) > 3.0
