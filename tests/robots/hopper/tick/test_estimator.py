import math

import numpy as np
import pytest

from stepgap.robots.hopper import RobotParameters
from stepgap.robots.hopper.tick.estimator import (
    APEX_DROP,
    SPEED_DELAY,
    FlightFit,
    JointRates,
    apex_passed,
    fitted_apex,
    mean_speed,
    scatter_about_parabolas,
    vertical_acceleration,
    with_reading,
    with_sample,
)

BOOM = RobotParameters().boom_length
COUNT_X = BOOM * 2 * math.pi / 5000  # 2.3 mm
COUNT_Y = BOOM * 2 * math.pi / 16384


EXACT = 1e-9
"""Count of an encoder that hardly rounds [m]."""


def fly(speed, apex, takeoff, gravity=5.2, acceleration=0.0, tick=1e-3, quantise=False):
    """Fit to a flight until the apex, where it has this speed, is detected; it accelerates forward evenly."""
    rise = math.sqrt(2 * (apex - takeoff) / gravity)
    fit, time = FlightFit(), 0.0
    while not apex_passed(fit):
        x = speed * time + acceleration * time * (time / 2 - rise)
        y = apex - gravity / 2 * (time - rise) ** 2
        if quantise:
            x, y = COUNT_X * round(x / COUNT_X), COUNT_Y * round(y / COUNT_Y)
        fit = with_sample(fit, time, x, y)
        time += tick
    return fit, time - rise


@pytest.mark.parametrize("acceleration", [0.0, -0.06, 0.5])
def test_an_exact_flight_is_fitted_exactly(acceleration):
    fit, late = fly(speed=0.31, apex=0.6, takeoff=0.3, acceleration=acceleration)
    assert fitted_apex(fit, EXACT) == pytest.approx((0.31, 0.6), abs=1e-12)
    assert late == pytest.approx(math.sqrt(2 * APEX_DROP / 5.2), abs=2e-3)


def test_the_mean_speed_of_a_decelerated_flight_is_that_at_half_of_its_time():
    fit, late = fly(speed=0.31, apex=0.6, takeoff=0.3, acceleration=-0.06)
    rise = math.sqrt(2 * 0.3 / 5.2)
    assert mean_speed(fit) == pytest.approx(0.31 + 0.06 * (rise - fit.latest / 2), abs=1e-12)
    assert late > 0


def rms_errors(fastest, count):
    """Errors of speed and height at the apex of flights with rounded counts."""
    rng = np.random.default_rng(0)
    errors = []
    for _ in range(200):
        speed, apex, takeoff = rng.uniform(0, fastest), rng.uniform(0.52, 0.64), rng.uniform(0.27, 0.29)
        fit, _ = fly(speed, apex, takeoff, acceleration=rng.normal(0, 0.05), quantise=True)
        errors.append(np.subtract(fitted_apex(fit, count), (speed, apex)))
    return np.sqrt(np.mean(np.square(errors), axis=0))


def test_quantised_flights_are_resolved_far_below_one_count():
    speed_error, height_error = rms_errors(0.4, COUNT_X)
    assert speed_error < 0.0015  # differencing at 1 kHz: 2.3 m/s per count
    assert height_error < COUNT_Y / 3


def test_a_flight_of_some_counts_is_resolved_to_less_than_a_count_per_flight():
    speed_error, _ = rms_errors(0.03, COUNT_X)
    free_error, _ = rms_errors(0.03, EXACT)
    assert speed_error < 0.95 * free_error
    assert speed_error < 0.8 * COUNT_X / 0.4


def test_no_speed_is_given_before_the_flight_is_long_enough():
    fit = FlightFit()
    assert math.isnan(mean_speed(fit))
    for time in np.arange(0, SPEED_DELAY - 1e-9, 1e-3):
        fit = with_sample(fit, time, 0.2 * time, 0.3 + time)
        assert math.isnan(mean_speed(fit))
    fit = with_sample(fit, SPEED_DELAY, 0.2 * SPEED_DELAY, 0.35)
    assert mean_speed(fit) == pytest.approx(0.2)


def test_a_flight_of_two_late_samples_has_no_speed_yet():
    fit = FlightFit()
    for time in (0.06, 0.12):
        fit = with_sample(fit, time, 0.2 * time, 0.3)
        assert math.isnan(mean_speed(fit))
        assert np.isnan(fitted_apex(fit, COUNT_X)).all()


@pytest.mark.parametrize("gravity", [5.2, 9.81])
def test_the_acceleration_of_a_flight_is_that_of_its_fall(gravity):
    fit, _ = fly(0.3, 0.6, 0.4, gravity=gravity)
    assert vertical_acceleration(fit) == pytest.approx(-gravity, rel=1e-6)
    assert math.isnan(vertical_acceleration(with_sample(FlightFit(), 0.0, 0.0, 0.4)))


def test_heights_without_a_maximum_have_no_apex():
    fit = FlightFit()
    for i in range(100):
        fit = with_sample(fit, i * 1e-3, 0.0, 0.3 + 0.1 * (i * 1e-3) ** 2)
    assert mean_speed(fit) == 0.0
    assert np.isnan(fitted_apex(fit, COUNT_X)).all()


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


def test_the_scatter_is_that_about_the_best_parabolas() -> None:
    rng = np.random.default_rng(3)
    time = np.arange(300) * 1e-3
    x = 0.5 * time - 0.1 * time**2 + rng.normal(0.0, 6e-4, 300)
    y = 0.3 + 1.2 * time - 2.6 * time**2 + rng.normal(0.0, 2e-4, 300)
    fit = FlightFit()
    for sample in zip(time.tolist(), x.tolist(), y.tolist(), strict=True):
        fit = with_sample(fit, *sample)
    right = [np.mean((np.polyval(np.polyfit(time, z, 2), time) - z) ** 2) for z in (x, y)]
    assert scatter_about_parabolas(fit) == pytest.approx(right, rel=1e-6)
    assert np.isnan(scatter_about_parabolas(FlightFit())).all()
