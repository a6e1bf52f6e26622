"""Heat and power of the motors against closed forms, and a robot that is stopped by them."""

from math import inf, sin, tau

import pytest

from stepgap.base.compiled_record import as_record
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.load import POWER_TIME, Load, add_load
from stepgap.robots.hopper.tick.safety import JointMotion, Limited

TICK = 1e-3
LIMITS = SafetyLimits(torque=30.0, continuous_torque=10.0, overload_time=2.0, mean_power=50.0)
REST = JointMotion(0.0, 0.8, 0.0, 0.0, 0.25, 0.5)


def ticks_until_stop(torque, motion=REST, limits=LIMITS, most=20_000):
    """Number of ticks until there is a reason to stop, and the reason; `torque` is a function of time."""
    record, load = as_record(limits)[0], Load()
    for count in range(1, most + 1):
        load, reason = add_load(record, TICK, load, motion, 0.0, torque(count * TICK))
        if reason:
            return count, Limited(reason)
    return most, Limited.NOTHING


def test_the_full_torque_is_withstood_for_the_overload_time():
    assert ticks_until_stop(lambda _: -30.0) == (pytest.approx(2000, abs=1), Limited.OVERLOAD)


def test_a_smaller_torque_is_withstood_for_longer():
    expected = 2000 * (30**2 - 10**2) / (20**2 - 10**2)
    assert ticks_until_stop(lambda _: 20.0) == (pytest.approx(expected, abs=1), Limited.OVERLOAD)


def test_the_continuous_torque_is_withstood_for_any_time():
    assert ticks_until_stop(lambda _: 10.0)[1] == Limited.NOTHING
    root = 2**0.5
    assert ticks_until_stop(lambda time: 9.99 * root * sin(tau * 5 * time))[1] == Limited.NOTHING
    assert ticks_until_stop(lambda time: 14.0 * root * sin(tau * 5 * time))[1] == Limited.OVERLOAD


def test_a_motor_cools_after_a_load_but_not_below_cold():
    record, load = as_record(LIMITS)[0], Load()
    for torque, ticks, expected in ((30.0, 1000, 800.0), (0.0, 4000, 400.0), (0.0, 9000, 0.0), (20.0, 1000, 300.0)):
        for _ in range(ticks):
            load, _ = add_load(record, TICK, load, REST, torque, 0.0)
        assert load.heat_1 == pytest.approx(expected)
        assert load.heat_2 == 0.0


def test_the_mean_power_follows_a_first_order_lag():
    motion = REST._replace(rate_1=3.0, rate_2=-2.0)
    record, load, reason = as_record(LIMITS)[0], Load(), 0
    for _ in range(round(POWER_TIME / TICK)):
        load, reason = add_load(record, TICK, load, motion, 4.0, -4.0)
    assert load.power == pytest.approx((4 * 1 + 4 * 5) * (1 - 2.718281828**-1), rel=1e-3)
    assert reason == 0
    assert ticks_until_stop(lambda _: 9.0, REST._replace(rate_1=10.0))[1] == Limited.POWER


@pytest.mark.parametrize("continuous", [inf, 30.0, 1e6])
def test_a_simulated_robot_is_never_stopped(continuous):
    limits = SafetyLimits(torque=30.0, continuous_torque=continuous, mean_power=inf)
    assert ticks_until_stop(lambda _: 30.0, REST._replace(rate_1=100.0), limits)[1] == Limited.NOTHING
