"""Calibrated intervals hold 95 % of errors of known distributions, and stay as they are where nothing is wrong."""

from collections.abc import Callable

import numpy as np
import pytest

from stepgap.base.normal import INTERVAL_95
from stepgap.learning.interval_calibration import LARGEST_FACTOR, IntervalCalibration
from stepgap.step import Array, Quantity, StepSpace

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)), (Quantity("push", "N", -10.0, 10.0),)
)
SHARE = np.array([0.5, 0.5])
STATES = np.random.default_rng(0).uniform(SPACE.state_centre - SPACE.state_scale, 2 * SPACE.state_centre, (800, 2))


def follow(std: Callable[[Array], Array], draws: Array, space: StepSpace = SPACE, unit: float = 1.0):
    """Calibration after errors of these standard deviations, in stated ones, and the factors of the N steps (N, n)."""
    calibration, factors, scaled = IntervalCalibration.start(space), [], STATES[: len(draws)]
    for state, after, draw in zip(scaled, np.roll(scaled, -1, axis=0), draws, strict=True):
        factors.append(calibration.factor(unit * state, unit * after, SHARE))
        calibration = calibration.after(unit * state, unit * after, SHARE, std(state) * draw / factors[-1])
    return calibration, np.array(factors)


def normal_errors(seed: int, steps: int = 800) -> Array:
    return np.random.default_rng(seed).standard_normal((steps, 2))


def of_speed(state: Array) -> Array:
    """Half as large at rest as stated, twice as large at full speed."""
    return np.repeat(2 ** (5 * state[0] - 1), 2)


def test_nothing_is_changed_before_the_first_step() -> None:
    calibration = IntervalCalibration.start(SPACE)
    assert np.array_equal(calibration.factor(STATES[0], STATES[1], SHARE), [1.0, 1.0])


@pytest.mark.parametrize(
    "draw",
    [
        lambda rng, size: rng.standard_normal(size),
        lambda rng, size: rng.standard_t(3, size) / np.sqrt(3),
        lambda rng, size: rng.standard_normal(size) * np.where(rng.random(size) < 0.02, 10.0, 1.0),
    ],
    ids=["normal", "heavy tails", "outliers"],
)
def test_intervals_hold_95_percent_in_every_part_of_the_range(draw: Callable[..., Array]) -> None:
    """Each error is as far from the mean as its known distribution says, whose scale depends on the speed."""
    inside, speeds = [], np.tile(STATES[200:, 0], 3)
    for seed in range(3):
        draws = draw(np.random.default_rng(seed), (800, 2))
        _, factors = follow(of_speed, draws)
        std = np.array([of_speed(state) for state in STATES])
        inside.append((np.abs(std * draws) <= INTERVAL_95 * factors)[200:])
    covered = np.concatenate(inside)
    for low in (0.0, 0.1, 0.2, 0.3):
        part = covered[(speeds >= low) & (speeds < low + 0.1)]
        assert np.all(np.abs(part.mean(axis=0) - 0.95) < 0.03), (low, part.mean(axis=0))


def test_factors_follow_the_standard_deviation_of_the_errors() -> None:
    calibration, _ = follow(of_speed, normal_errors(1))
    for speed in (0.05, 0.2, 0.35):
        state = np.array([speed, 0.55])
        found = calibration.factor(state, np.array([0.2, 0.55]), SHARE)
        assert np.allclose(np.log2(found), np.log2(of_speed(state)), atol=0.5)


def test_errors_as_stated_leave_the_intervals_as_they_are() -> None:
    """No dependence is invented: the factors of equal errors stay near 1, and 95 % remain inside."""
    draws = [normal_errors(seed, 500) for seed in range(4)]
    factors = np.array([follow(lambda state: np.ones(2), each)[1] for each in draws])
    assert np.mean(np.abs(np.log(factors)) > np.log(1.35)) < 0.05
    assert abs(np.mean(np.abs(draws) <= INTERVAL_95 * factors) - 0.95) < 0.01


def test_a_change_of_the_robot_is_followed() -> None:
    draws = normal_errors(2)
    draws[400:] *= 3
    _, factors = follow(lambda state: np.ones(2), draws)
    assert np.all(factors[:400].mean(axis=0) < 1.2)
    assert np.all((factors[600:].mean(axis=0) > 2) & (factors[600:].mean(axis=0) < 3.5))


def test_units_do_not_matter() -> None:
    metric, draws = SPACE, normal_errors(3, 60)
    small = tuple(Quantity(each.name, "u", 8 * each.lower, 8 * each.upper) for each in metric.state)
    _, factors = follow(of_speed, draws)
    _, scaled = follow(of_speed, draws, StepSpace(small, metric.command), 8.0)
    assert np.allclose(factors, scaled, rtol=1e-12)


def test_a_coordinate_without_an_error_says_nothing() -> None:
    start = IntervalCalibration.start(SPACE)
    found = start.after(STATES[0], STATES[1], SHARE, np.array([np.nan, 5.0]))
    assert not found.weights[0].any()
    assert not found.information[0].any()
    assert found.factor(STATES[0], STATES[1], SHARE)[1] > 1


@pytest.mark.parametrize("ratio", [0.0, 1e9, np.inf])
@pytest.mark.parametrize("state", [np.full(2, 1e9), np.full(2, np.nan), np.zeros(2)])
def test_factors_are_bounded_whatever_happens(ratio: float, state: Array) -> None:
    calibration = IntervalCalibration.start(SPACE)
    for _ in range(300):
        calibration = calibration.after(state, -state, SHARE, np.full(2, ratio))
    for each in (state, -state, STATES[0]):
        factor = calibration.factor(each, each, SHARE)
        assert np.all((factor >= 1 / LARGEST_FACTOR / (1 + 1e-9)) & (factor <= LARGEST_FACTOR * (1 + 1e-9)))
