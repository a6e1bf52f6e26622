import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.compiled_record import as_record
from stepgap.rigs.rig import HEALTHY, Health
from stepgap.robots.hopper import RobotParameters
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.safety import (
    BRAKE_GROWTH,
    BRAKED,
    DOUBTS,
    STOPS,
    JointMotion,
    Limited,
    Watch,
    check_torque,
)
from stepgap.robots.hopper.tick.stage import Stage

LIMITS = SafetyLimits.of(RobotParameters())
TIGHT = SafetyLimits(
    torque=38.0,
    torque_step=5.0,
    joint_speed=80.0,
    lean_angle=1.2,
    fold_angle=2.5,
    shortest_leg=0.1,
    longest_leg=0.31,
    lowest_hip=0.1,
    highest_hip=0.9,
)
STANDING = JointMotion(0.1, 0.5, 0.0, 0.0, 0.26, 0.5)
ANY = st.floats(allow_nan=True, allow_infinity=True, width=64)
MOTIONS = st.builds(JointMotion, ANY, ANY, ANY, ANY, ANY, ANY)


@cache
def record_of(limits):
    """The limits as a record for compiled code."""
    return as_record(limits)[0]


def checked_torque(limits, watch, motion, health, torque_1, torque_2, doubts=0):
    """Result of the compiled check, with its reason as a `Limited`."""
    stage = Stage(limits.torque, limits.joint_speed)
    torques = float(torque_1), float(torque_2)
    checked = check_torque(record_of(limits), stage, watch, motion, health, int(doubts), *torques)
    return checked._replace(limited=Limited(checked.limited))


def check(torque_1, torque_2, limits=LIMITS, watch=None, health=HEALTHY, **motion):
    return checked_torque(limits, watch or Watch(), STANDING._replace(**motion), health, torque_1, torque_2)


@given(ANY, ANY, MOTIONS)
def test_for_any_input_the_torque_is_finite_and_within_limits(torque_1, torque_2, motion):
    checked = checked_torque(LIMITS, Watch(), motion, HEALTHY, torque_1, torque_2)
    assert abs(checked.torque_1) <= LIMITS.torque
    assert abs(checked.torque_2) <= LIMITS.torque
    if not all(map(math.isfinite, (torque_1, torque_2, *motion))):
        assert checked[:3] == (0.0, 0.0, Limited.NOT_FINITE)


def test_100_000_random_ticks_never_exceed_a_limit_and_a_stop_is_final():
    rng = np.random.default_rng(5)
    ticks, odd = 100_000, [math.nan, math.inf, -math.inf, 1e308, -1e308]
    torques = rng.normal(0, 40, (ticks, 2))
    motions = rng.normal([0, 1.2, 0, 0, 0.2, 0.5], [0.4, 0.4, 15, 15, 0.03, 0.12], (ticks, 6))
    for values in (torques, motions):
        bad = rng.random(values.shape) < 0.002
        values[bad] = rng.choice(odd, bad.sum())
    health = rng.random((ticks, 4)) < [0.2, 0.2, 0.2, 0.005]
    limits, stage, late = record_of(TIGHT), Stage(TIGHT.torque, TIGHT.joint_speed), rng.integers(1, 4, ticks).tolist()
    watch, seen, step = Watch(), set(), TIGHT.torque_step * (1 + 1e-12)
    for torque, motion, well, ticks_late in zip(torques.tolist(), motions.tolist(), health.tolist(), late, strict=True):
        well[2] *= ticks_late
        checked = check_torque(limits, stage, watch, JointMotion(*motion), Health(*well), 0, *torque)
        applied, before, limited = checked[:2], watch[:2], checked.limited
        seen.add(limited)
        assert abs(applied[0]) <= TIGHT.torque  # false for NaN
        assert abs(applied[1]) <= TIGHT.torque
        assert checked.watch[:2] == applied
        if limited & STOPS:
            turning = (motion[2] + motion[3], motion[2] - motion[3])
            assert (
                applied == (0.0, 0.0)
                if limited & ~BRAKED
                else all(torque * speed <= 0 for torque, speed in zip(applied, turning, strict=True))
            )
            assert abs(applied[0]) <= abs(before[0]) + step
            assert abs(applied[1]) <= abs(before[1]) + step
            assert checked.watch.stopped == limited
        else:
            assert abs(applied[0] - before[0]) <= step
            assert abs(applied[1] - before[1]) <= step
        after = check_torque(limits, stage, checked.watch, STANDING, HEALTHY, 0, 1.0, 1.0)
        assert (after.limited & STOPS == 0) == (limited & STOPS == 0), "a stop lasts, nothing else does"
        watch = Watch() if limited & STOPS else checked.watch
    elsewhere = {Limited.NOTHING, Limited.SPEED_GREW, Limited.OVERLOAD, Limited.POWER, *DOUBTS}
    exceeded = {reason for reason in Limited if any(reason & limited for limited in seen)}
    assert exceeded == set(Limited) - elsewhere, "every limit was exceeded"


@given(st.floats(-40, 40), st.floats(-40, 40), st.floats(0.1, 2), st.floats(-50, 50), st.floats(-50, 50))
def test_an_allowed_torque_is_written_as_requested(torque_1, torque_2, alpha_2, rate_1, rate_2):
    checked = check(torque_1, torque_2, alpha_2=alpha_2, rate_1=rate_1, rate_2=rate_2)
    assert checked == (torque_1, torque_2, Limited.NOTHING, Watch(torque_1, torque_2))


def test_a_fast_joint_and_a_stretched_leg_are_reported():
    assert check(1, 1, rate_1=100, rate_2=100)[:3] == (0, 0, Limited.JOINT_SPEED)
    assert Limited.JOINT_SPEED.stops
    stretching = check(-2, 4, alpha_2=0.05)  # τ₁ < τ₂ closes the top links, which stretches the leg
    assert stretching[:3] == (1, 1, Limited.STRETCH)
    assert not Limited.STRETCH.stops
    assert check(4, -2, alpha_2=0.05)[:3] == (4, -2, Limited.NOTHING)
    assert check(50, -60)[:3] == (40, -40, Limited.TORQUE)


@pytest.mark.parametrize(
    ("motion", "reason"),
    [
        ({"alpha_1": -1.3}, Limited.JOINT_ANGLE),
        ({"alpha_2": 2.6}, Limited.JOINT_ANGLE),
        ({"leg_length": 0.09}, Limited.LEG_LENGTH),
        ({"leg_length": 0.32}, Limited.LEG_LENGTH),
        ({"hip_height": 0.05}, Limited.HIP_HEIGHT),
        ({"hip_height": 1.0}, Limited.HIP_HEIGHT),
        ({"hip_height": 1.0, "alpha_1": 2.0}, Limited.HIP_HEIGHT | Limited.JOINT_ANGLE),
    ],
)
def test_a_robot_out_of_its_range_is_stopped(motion, reason):
    assert check(1, 1, TIGHT, **motion)[:3] == (0, 0, reason)
    assert reason.stops


def test_torque_steps_are_limited_relative_to_the_last_written_torque():
    checked = check(30, -3, TIGHT)
    assert checked[:3] == (5, -3, Limited.TORQUE_STEP)
    assert check(30, -3, TIGHT, watch=checked.watch)[:3] == (10, -3, Limited.TORQUE_STEP)


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (Health(frame_lost=True), Limited.LOST_FRAMES),
        (Health(stale=True), Limited.STALE),
        (Health(late=1), Limited.LATE),
    ],
)
def test_a_budget_is_of_bad_ticks_in_a_row(bad, reason):
    def limited(ticks):
        watch, found = Watch(), []
        for health in ticks:
            checked = check(1, 1, watch=watch, health=health)
            watch = checked.watch
            found.append(checked.limited)
        return found

    well = Limited.NOTHING
    assert limited([bad, bad, HEALTHY, bad, bad, Health(), bad]) == [well] * 7
    assert limited([bad, bad, bad, HEALTHY]) == [well, well, reason, reason]


def test_one_long_delay_counts_as_all_the_ticks_it_took():
    assert check(1, 1, health=Health(late=2)).limited == Limited.NOTHING
    assert check(1, 1, health=Health(late=3)).limited == Limited.LATE


def test_motors_brake_before_torque_goes_off_where_sensors_are_reliable():
    limits, watch, torques = (
        replace(TIGHT, brake_ticks=3, brake_damping=0.5, torque_step=math.inf),
        Watch(20.0, 20.0),
        [],
    )
    for rates in [(4.0, 6.0), (-4.0, 6.0), (90.0, 0.0), (4.0, 6.0)]:
        hip_height = 0.5 if torques else 1.0
        checked = check(38, 38, limits, watch, rate_1=rates[0], rate_2=rates[1], hip_height=hip_height)
        torques.append(checked[:2])
        watch = checked.watch
    assert torques[:2] == [(-5.0, 1.0), (-1.0, 5.0)]
    assert torques[2] == (0.0, 0.0), "an encoder may be wrong where a joint seems too fast"
    assert watch.stopped == Limited.HIP_HEIGHT | Limited.JOINT_SPEED | Limited.SPEED_GREW
    watch = Watch(stopped=Limited.HIP_HEIGHT, braked=2)
    for braking in (True, False, False):
        checked = check(38, 38, limits, watch, rate_1=1.0)
        assert (checked.torque_1 != 0) == braking
        watch = checked.watch


def test_braking_torque_grows_by_the_largest_step_and_driving_torque_ends_at_once():
    watch, torques = Watch(38.0, -38.0), []
    for speed in (40.0, 40.0, 40.0, 40.0, 32.5, -40.0, 40.0):
        checked = check(0, 0, TIGHT, watch, rate_1=speed, hip_height=1.0)
        torques.append(checked[:2])
        watch = checked.watch
    first, second = zip(*torques, strict=True)
    assert first == (-5.0, -10.0, -15.0, -20.0, -25.0, 5.0, -5.0)
    assert second == (-32.0, -32.0, -32.0, -32.0, -26.0, 5.0, -5.0), (
        "it already braked with more than the needed torque"
    )


def test_the_braking_torque_is_limited():
    limits = replace(TIGHT, brake_torque=7.0, torque_step=math.inf)
    assert check(0, 0, limits, rate_1=40.0, hip_height=1.0)[:2] == (-7.0, -7.0)


@given(st.lists(st.floats(-60, 60), min_size=2, max_size=30))
def test_the_brake_is_released_for_good_when_the_speed_grows(speeds):
    watch, slowest = Watch(), math.inf
    for speed in speeds:
        checked = check(0, 0, TIGHT, watch, rate_1=speed, hip_height=1.0)
        slowest = min(slowest, abs(speed))
        grew = bool(watch.stopped & Limited.SPEED_GREW) or abs(speed) > slowest + BRAKE_GROWTH
        assert bool(checked.limited & Limited.SPEED_GREW) == grew
        assert not grew or checked[:2] == (0.0, 0.0)
        assert grew or checked.torque_1 * speed <= 0.0
        watch = checked.watch


@pytest.mark.parametrize("doubt", DOUBTS)
def test_torque_is_off_at_once_with_a_doubtful_sensor_also_while_the_motors_brake(doubt):
    braking = Watch(-5.0, -5.0, stopped=int(Limited.HIP_HEIGHT), braked=3, slowest=9.0)
    for watch in (Watch(10.0, 10.0), braking):
        checked = checked_torque(TIGHT, watch, STANDING._replace(rate_1=9.0), HEALTHY, 5.0, 5.0, doubt)
        assert checked[:3] == (0.0, 0.0, Limited(watch.stopped) | doubt)
        assert doubt.stops


def test_the_emergency_stop_stops_at_once():
    assert check(1, 1, health=Health(emergency_stop=True))[:3] == (0, 0, Limited.EMERGENCY_STOP)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("torque", math.nan),
        ("torque", math.inf),
        ("torque", 0.0),
        ("torque_step", -1.0),
        ("stretch_angle", -0.1),
        ("fold_angle", 0.05),
        ("longest_leg", math.nan),
        ("highest_hip", -math.inf),
        ("lost_frames", 6),
    ],
)
def test_limits_without_effect_are_refused(name, value):
    with pytest.raises(ValueError, match=f"^{name} = {value}, but it must"):
        replace(LIMITS, **{name: value})
