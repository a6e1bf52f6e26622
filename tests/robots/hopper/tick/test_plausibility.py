"""Plausibility checks of sensors: no false alarms on twins of the family, and each reason on its own."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.compiled_record import as_record
from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.rigs.rig import HEALTHY, LOST, Health
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.tick.encoder_track import NO_JUMP, EncoderTrack, may_rest, with_angle
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.plausibility import MOST_SHARED, jump_ratio
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus

ROBOT, GAINS = RobotParameters(), Gains()
LIMITS = SafetyLimits(
    torque=38.0,
    jump_angle=0.004,
    sample_jitter=0.1,
    frozen_time=0.016,
    ground_height=0.03,
    lost_frames=5,
    stale_ticks=5,
)
TICK, COUNT = 1e-3, 2 * np.pi / 16384


def hops_until_stop(gap, rng, hops, loss, limits=LIMITS):
    """Number of hops with random commands and lost frames, and why the safety function stopped the robot."""
    twin = Twin(ROBOT, gap, rng)
    twin.connect()
    control, reading = HopControl(twin.sensor_model, ROBOT, GAINS, limits), twin.read()
    time, applied, made, command = 0.0, (0.0, 0.0), 0, (-4.0, -3.0)
    while made < hops:
        chance, health = rng.random(), HEALTHY
        if chance < loss:
            health = LOST
        else:
            if chance > 1 - loss / 10:  # the tick begins late, with the torques of the one before
                twin.write(applied)
                time, health = time + TICK, Health(late=1)
            reading = twin.read()
        torques, flags = control.tick(time, reading, Order(Mode.STEP, 1.0, command), applied, health)
        if flags & (TickFlag.STOPPED | TickFlag.FAILED):
            return made, control.stopped or control.status.label
        if flags & TickFlag.STEP_ENDED:
            made, command = made + 1, (rng.uniform(-10, 2), rng.uniform(-9, 3))
        applied, time = twin.write(torques), time + TICK
    return made, ""


@pytest.mark.parametrize("seed", [0, 15, 104, 106, 108])
def test_there_is_no_false_alarm_on_twins_with_lost_frames_and_late_ticks(seed):
    rng = np.random.default_rng(seed)
    gap = RealityGap.random(rng) if seed else RealityGap()
    assert hops_until_stop(gap, rng, 12, loss=0.05) == (12, "")


@pytest.mark.parametrize("seed", [22, 101])
def test_a_robot_whose_links_vibrate_is_stopped_for_its_joint_speed_alone(seed):
    """Their control loop is unstable with the delay and the lag of their drives; no sensor is wrong."""
    rng = np.random.default_rng(seed)
    _, reason = hops_until_stop(RealityGap.random(rng), rng, 12, loss=0.05, limits=replace(LIMITS, joint_speed=80.0))
    assert reason.startswith("joint speed (")


@cache
def flight():
    """Readings, times and torques of some hops of the twin."""
    twin = Twin(ROBOT, RealityGap(), np.random.default_rng(0))
    twin.connect()
    control = HopControl(twin.sensor_model, ROBOT, GAINS, LIMITS)
    ticks, applied = [], (0.0, 0.0)
    for number in range(2600):
        reading = twin.read()
        torques, _ = control.tick(number * TICK, reading, Order(Mode.STEP, 1.0, (-4.0, -3.0)), applied)
        ticks.append((reading, applied))
        applied = twin.write(torques)
    return twin.sensor_model, ticks


def first_doubt(change, begin):
    """Number of ticks after which readings that are changed from a tick on are doubted, and the reasons."""
    sensors, ticks = flight()
    control = HopControl(sensors, ROBOT, GAINS, LIMITS)
    for number, (reading, applied) in enumerate(ticks):
        changed = change(reading) if number >= begin else reading
        _, flags = control.tick(number * TICK, changed, Order(Mode.STEP, 1.0, (-4.0, -3.0)), applied)
        if flags & TickFlag.STOPPED:
            assert control.status == StepStatus.DOUBTFUL
            return number - begin, control.stopped
    return None, ""


@pytest.mark.parametrize("begin", range(1450, 2500, 150))
@pytest.mark.parametrize(
    ("sensor", "counts"),
    [("motor_1", 23), ("motor_1", -91), ("motor_2", 228), ("boom_horizontal", 7), ("boom_vertical", -23)],
)
def test_a_jump_of_half_a_degree_and_more_is_detected_at_once_in_every_phase(sensor, counts, begin):
    after, reason = first_doubt(lambda reading: reading._replace(**{sensor: getattr(reading, sensor) + counts}), begin)
    assert after is not None
    assert after <= 1
    name = {"boom_horizontal": "yaw", "boom_vertical": "pitch"}.get(sensor, sensor.replace("_", " "))
    assert f"{name} jumped" in reason


@pytest.mark.parametrize("after", range(6))
@pytest.mark.parametrize(("sensor", "counts"), [("motor_1", 41), ("motor_1", -41), ("motor_2", 41), ("motor_2", -41)])
def test_a_jump_of_0_9_degrees_is_detected_just_after_touchdown(sensor, counts, after):
    contact = np.array([reading.contact_force > 5.0 for reading, _ in flight()[1]])
    touchdown = 1450 + int(np.flatnonzero(contact[1450:] & ~contact[1449:-1])[0])
    found, reason = first_doubt(
        lambda reading: reading._replace(**{sensor: getattr(reading, sensor) + counts}), touchdown + after
    )
    assert found is not None
    assert found <= 2
    assert "jumped" in reason, "just after an impact, the other motor may be named"


def ratio(size, other, change=0.0, other_change=0.0):
    """Jump of motor 1 as a multiple of the largest one that is not doubted, with a jump of motor 2."""
    pair = (NO_JUMP._replace(size=size, change=change), NO_JUMP._replace(size=other, change=other_change))
    return jump_ratio(as_record(LIMITS)[0], LIMITS.jump_angle, *pair, TICK, COUNT)


def test_a_jump_that_both_motors_share_in_opposite_directions_folds_the_leg_and_is_no_fault():
    assert ratio(0.010, 0.0) > 1
    assert ratio(0.010, 0.010) > 1, "in the same direction they do not fold the leg"
    assert ratio(0.010, -0.010) < 1
    assert ratio(-0.010, 0.008) < 1
    assert ratio(0.010, -0.004) > 1, "too small to explain it"
    assert ratio(0.0, -0.5) < 1, "judged as that of motor 2"
    assert ratio(0.5, -0.5) > 1, f"more than {MOST_SHARED:g} times the smallest one"
    assert ratio(0.0, 0.0, change=0.05) > 1
    assert ratio(0.0, 0.0, change=0.05, other_change=-0.045) < 1


@given(st.floats(-0.03, 0.03), st.floats(0.0085, 0.1))
def test_a_jump_of_one_encoder_is_found_at_an_impact_of_any_size(impact, jump):
    """It is a jump of that motor or, if the impact hides it, of the other one."""
    assert max(ratio(impact + jump, -impact), ratio(-impact, impact + jump)) > 1


def test_without_a_fault_there_is_no_doubt():
    assert first_doubt(lambda reading: reading, 0) == (None, "")


@given(
    st.floats(-40, 40),
    st.floats(-3000, 3000),
    st.lists(st.integers(1, 3), min_size=8, max_size=8),
    st.integers(4, 6),
    st.floats(-0.5, 0.5),
)
def test_the_size_of_a_jump_is_measured_whatever_the_speed(speed, acceleration, intervals, at, jump):
    """At constant acceleration the estimate is exact up to that of unequal intervals."""
    track, time, sizes = EncoderTrack(), 0.0, []
    for number, ticks in enumerate(intervals):
        time += ticks * TICK
        angle = speed * time + acceleration * time**2 / 2 + (jump if number >= at else 0.0)
        track, found = with_angle(track, TICK, COUNT, time, angle, 0.0, False)
        sizes.append(found.size)
    longest = max(intervals[at - 1 : at + 2])
    tolerance = abs(acceleration) * (3 * TICK) ** 2
    assert sizes[at + 1] * longest**2 == pytest.approx(jump, abs=tolerance + 1e-9)


def test_a_reading_that_is_not_new_changes_nothing():
    track, _ = with_angle(EncoderTrack(), TICK, COUNT, 0.001, 1.0, 0.0, True)
    again, jump = with_angle(track, TICK, COUNT, 0.001, 2.0, 0.0, True)
    assert again == track
    assert jump == NO_JUMP


def test_standing_still_counts_only_under_torque_and_ends_with_a_movement():
    track = EncoderTrack()
    for number in range(20):
        track, _ = with_angle(track, TICK, COUNT, number * TICK, COUNT * (number % 2), 1.0, number % 2 == 0)
    assert track.still == pytest.approx(9 * TICK), "one count is no movement"
    track, _ = with_angle(track, TICK, COUNT, 20 * TICK, 2 * COUNT, 1.0, True)
    assert track.still == 0.0


def test_a_link_that_may_rest_has_not_stood_still():
    track = EncoderTrack()
    for number in range(9):
        track, _ = with_angle(track, TICK, COUNT, number * TICK, 0.0, 0.0, True)
    assert track.still > 0
    assert may_rest(track) == track._replace(still=0.0)


def test_infinite_limits_doubt_nothing():
    sensors, ticks = flight()
    unlimited = replace(LIMITS, jump_angle=np.inf, frozen_time=np.inf, ground_height=np.inf, joint_speed=np.inf)
    control = HopControl(sensors, ROBOT, GAINS, unlimited)
    for number in range(800):
        reading = ticks[number][0]._replace(motor_1=0.0, boom_vertical=100.0 * (number % 2), contact_force=100.0)
        control.tick(number * TICK, reading, Order(Mode.STEP, 1.0, (0.0, 0.0)), (5.0, 5.0))
    assert control.stopped == ""
