import math

import numpy as np
import pytest

from stepgap.robots.hopper import RobotParameters
from stepgap.robots.hopper.estimator import (
    APEX_DROP,
    SPEED_DELAY,
    FlightFit,
    JointRates,
    apex_height,
    apex_passed,
    fitted_speed,
    with_reading,
    with_sample,
)

BOOM = RobotParameters().boom_length
COUNT_X = BOOM * 2 * math.pi / 5000  # 2.3 mm
COUNT_Y = BOOM * 2 * math.pi / 16384


def fly(speed, apex, takeoff, gravity=5.2, tick=1e-3, quantise=False):
    """Fit to a ballistic flight until the apex is detected."""
    rise = math.sqrt(2 * (apex - takeoff) / gravity)
    fit, time = FlightFit(), 0.0
    while not apex_passed(fit):
        x, y = speed * time, apex - gravity / 2 * (time - rise) ** 2
        if quantise:
            x, y = COUNT_X * round(x / COUNT_X), COUNT_Y * round(y / COUNT_Y)
        fit = with_sample(fit, time, x, y)
        time += tick
    return fit, time - rise


def test_an_exact_flight_is_fitted_exactly():
    fit, late = fly(speed=0.31, apex=0.6, takeoff=0.3)
    assert fitted_speed(fit) == pytest.approx(0.31, abs=1e-12)
    assert apex_height(fit) == pytest.approx(0.6, abs=1e-12)
    assert late == pytest.approx(math.sqrt(2 * APEX_DROP / 5.2), abs=2e-3)


def test_quantised_flights_are_resolved_far_below_one_count():
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(200):
        speed, apex, takeoff = rng.uniform(0, 0.4), rng.uniform(0.52, 0.64), rng.uniform(0.27, 0.29)
        fit, _ = fly(speed, apex, takeoff, quantise=True)
        errors.append([fitted_speed(fit) - speed, apex_height(fit) - apex])
    speed_error, height_error = np.sqrt(np.mean(np.square(errors), axis=0))
    assert speed_error < 0.002  # differencing at 1 kHz: 2.3 m/s per count
    assert height_error < COUNT_Y / 3


def test_no_speed_is_given_before_the_flight_is_long_enough():
    fit = FlightFit()
    assert math.isnan(fitted_speed(fit))
    for time in np.arange(0, SPEED_DELAY - 1e-9, 1e-3):
        fit = with_sample(fit, time, 0.2 * time, 0.3 + time)
        assert math.isnan(fitted_speed(fit))
    fit = with_sample(fit, SPEED_DELAY, 0.2 * SPEED_DELAY, 0.35)
    assert fitted_speed(fit) == pytest.approx(0.2)


def test_a_flight_of_two_late_samples_has_no_speed_yet():
    fit = FlightFit()
    for time in (0.06, 0.12):
        fit = with_sample(fit, time, 0.2 * time, 0.3)
        assert math.isnan(fitted_speed(fit))


def test_joint_rates_follow_a_ramp_after_their_span():
    rates, seen = JointRates(), []
    for i in range(5):
        rates = with_reading(rates, i * 1e-3, 0.5 * i * 1e-3, -2.0 * i * 1e-3)
        seen.append((rates.rate_1, rates.rate_2))
    assert seen[:2] == [(0.0, 0.0), (0.0, 0.0)]
    assert seen[4] == pytest.approx((0.5, -2.0))


def test_lost_or_late_readings_do_not_change_the_rates_of_a_ramp():
    rates, now, rng = JointRates(), 0.0, np.random.default_rng(1)
    for tick in range(200):
        lost = tick > 3 and rng.random() < 0.3
        reading = now if lost else tick * 1e-3 + rng.uniform(0, 5e-4)
        rates, now = with_reading(rates, reading, 4.0 * reading, -7.0 * reading), reading
        assert tick < 2 or (rates.rate_1, rates.rate_2) == pytest.approx((4.0, -7.0))
