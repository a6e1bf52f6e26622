"""What is trusted follows from likelihoods: an outlier, a change, a return, a map that is worse than none, a bound."""

from math import nan

import numpy as np
import pytest

from stepgap.learning.disturbance import DisturbanceFilter
from stepgap.learning.observations import observe
from stepgap.learning.outliers import LEAST_KNOWN
from stepgap.learning.residual import Residual, no_residual
from stepgap.learning.residual_fit import fit_residual
from stepgap.learning.trust import MOST_STRAINED, Alarm, PredictedStep, Trust
from stepgap.step import Array
from tests.learning.test_outliers import NOISE, NOMINAL, SCALE, hops, log_of

COUNT = 60
YAWS = np.append(nan, 0.3 * np.arange(COUNT - 1))
INPUTS = np.random.default_rng(5).uniform(-0.5, 0.5, (COUNT, 4))
MEAN = np.array([0.06, 0.01])
"""Prediction of the residual, which is right unless the robot changes."""
CHANGE = np.array([0.2, -0.03])


def noise(seed: int = 4) -> Array:
    """Errors of a right prediction."""
    return np.random.default_rng(seed).normal(0, NOISE, (COUNT, 2))


def fitted(steps: int = 60) -> Residual:
    return fit_residual("linear", observe(log_of(hops(steps, 1, {})), NOMINAL))


def started(
    residual: Residual,
    *,
    drift: bool = True,
    monitor: bool = True,
    reject_outliers: bool = True,
    warm_start: bool = False,
) -> Trust:
    rules = {"drift": drift, "monitor": monitor, "reject_outliers": reject_outliers}
    return Trust.start(SCALE, residual, warm_start=warm_start, **rules)


def after(trust: Trust, residual: Residual, errors: Array, *, mean: Array = MEAN):
    """Trust after steps with these errors of the residual, the numbers of the outliers, and the alarms, from 0 on."""
    outliers, alarms = [], []
    for number, (error, yaw, inputs) in enumerate(zip(errors, YAWS, INPUTS, strict=False)):
        step = PredictedStep(inputs, error + mean, mean, residual.noise_std, yaw)
        trust = trust.after(residual, step)
        outliers += [number] if trust.outlier else []
        alarms += [Alarm(number, trust.alarm)] if trust.alarm else []
    return trust, outliers, alarms


def filter_over(errors: Array, omitted: list[int]) -> DisturbanceFilter:
    found, std = DisturbanceFilter.initial(2, 4), fitted().noise_std
    for number, (error, yaw, inputs) in enumerate(zip(errors, YAWS, INPUTS, strict=True)):
        found = found if number in omitted else found.updated(error, yaw, std, inputs)
    return found


@pytest.mark.parametrize("size", [0.15, 0.5, 30.0])
@pytest.mark.parametrize("pushed", [[], [12], [12, 14], [3, 20, 41]], ids=str)
def test_single_errors_of_any_size_are_outliers_and_change_nothing(pushed: list[int], size: float) -> None:
    residual, errors = fitted(), noise()
    errors[pushed, 0] += size
    trust, outliers, alarms = after(started(residual), residual, errors)
    assert (outliers, alarms) == (pushed, [])
    found, expected = trust.predict(residual, 1.0), filter_over(errors, pushed).predict(1.0, residual.noise_std)
    for one, other in zip(vars(found).values(), vars(expected).values(), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("seed", range(8))
def test_a_change_is_followed_within_four_steps_and_forgotten_when_it_ends(seed: int) -> None:
    """The change is linear in state and command; after ten steps it is known to a few standard deviations of noise."""
    residual, errors = fitted(), noise(seed)
    changed = CHANGE + INPUTS @ np.random.default_rng(seed).normal(0, 0.3 * np.abs(CHANGE), (4, 2))
    errors[20:45] += changed[20:45]
    trust, _, alarms = after(started(residual), residual, errors[:35])
    assert [alarm.source for alarm in alarms] == ["changed"]
    assert alarms[0].step in range(20, 24)
    found = trust.predict(residual, YAWS[35])
    assert (np.abs(found.mean(INPUTS[35]) - changed[35]) < 6 * NOISE).all()
    _, _, alarms = after(started(residual), residual, errors)
    assert [alarm.source for alarm in alarms] == ["changed", "earlier"]
    assert alarms[1].step in (45, 46)


def test_healthy_steps_raise_no_alarm() -> None:
    residual = fitted()
    found = [after(started(residual), residual, noise(seed))[2] for seed in range(60)]
    assert sum(map(len, found)) <= 2, "3,600 healthy steps"


@pytest.mark.parametrize("drift", [True, False])
@pytest.mark.parametrize(("warm_start", "wrong_steps"), [(True, 1), (False, 6)])
def test_a_residual_that_is_worse_than_none_is_left_out(drift: bool, warm_start: bool, wrong_steps: int) -> None:
    """After its first step if that is of another run; it is wrong in another way at every step."""
    rng, residual = np.random.default_rng(6), fitted()
    trust, used = started(residual, drift=drift, warm_start=warm_start), []
    for number in range(12):
        wrong = rng.normal(0, 0.3, 2) * [1, 0.2]
        step = PredictedStep(INPUTS[number], rng.normal(0, NOISE), wrong, residual.noise_std, nan)
        trust = trust.after(residual, step)
        used.append(trust.uses_residual)
    assert used.count(True) < wrong_steps
    assert not any(used[wrong_steps - 1 :])
    assert after(started(residual, monitor=False), residual, noise() + 1.0)[0].uses_residual


def test_a_robot_that_does_not_follow_is_pushed_against_a_bound_for_two_steps_only() -> None:
    """Then neither residual nor disturbance is used, until a prediction is right."""
    rng, residual = np.random.default_rng(7), fitted()
    errors = np.abs(rng.normal(0.3, 0.15, (12, 2))) * [1, 0.2]
    for at_bound in (True, False):
        trust, used = started(residual, drift=False), []
        for number, error in enumerate(errors):
            inputs = np.append(INPUTS[number][:3], 1.0 if at_bound else 0.5)
            step = PredictedStep(inputs, error + 1.0, np.ones(2), residual.noise_std, nan)
            trust = trust.after(residual, step)
            used.append(trust.uses_residual)
        assert used[: MOST_STRAINED - 1] == [True] * (MOST_STRAINED - 1)
        assert used[MOST_STRAINED - 1 :] == [not at_bound] * (len(used) - MOST_STRAINED + 1)
        again, _, _ = after(trust, residual, noise()[:1], mean=np.ones(2))
        assert again.uses_residual


def test_a_robot_is_not_pushed_against_a_bound_by_a_map_that_knows_nothing() -> None:
    """However well the step fits into a prediction without any certainty."""
    residual, std = fitted(), np.array([0.6, 0.01]) * SCALE
    for at_bound in (True, False):
        trust = started(residual)
        for number in range(MOST_STRAINED):
            assert trust.uses_residual
            inputs = np.append(INPUTS[number][:3], -1.0 if at_bound else -0.5)
            trust = trust.after(residual, PredictedStep(inputs, MEAN, MEAN, std, nan))
        assert trust.uses_residual != at_bound


def test_outliers_are_used_if_that_is_wanted_or_too_little_is_known() -> None:
    errors = noise()
    errors[12, 0] += 0.5
    few = fitted(LEAST_KNOWN - 1)
    _, outliers, alarms = after(started(few), few, errors)
    assert (outliers, alarms) == ([], [])
    assert after(started(fitted(), reject_outliers=False), fitted(), errors)[1] == []


def test_where_it_is_not_estimated_it_is_zero() -> None:
    errors = noise()
    errors[12, 0] += 0.5
    for residual, drift in ((fitted(), False), (no_residual(2, 2), True)):
        trust, _, _ = after(started(residual, drift=drift), residual, errors)
        found = trust.predict(residual, 1.0)
        np.testing.assert_array_equal(found.mean(INPUTS), np.zeros((COUNT, 2)))
        np.testing.assert_array_equal(found.std(INPUTS), np.zeros((COUNT, 2)))
