"""Yaw and pitch compared in size with leg and flight: exact on ideal motion, silent without faults, sure with them."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.tick.closures import MOST_EVIDENCE, SLIP_DEVIATION, Standing, YawEvidence, slip_of, with_slip
from stepgap.robots.hopper.tick.closures import _with_reading as with_reading
from stepgap.robots.hopper.tick.encoder_track import RESIDUES, Counts, EncoderTrack, is_noisy, with_angle, with_count
from stepgap.robots.hopper.tick.estimator import FlightFit, after_vertex, with_sample
from stepgap.robots.hopper.tick.hop_control import HopControl, HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.safety import DOUBTS, STOPS, Limited
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus

ROBOT, GAINS, TICK = RobotParameters(), Gains(), 1e-3
LIMITS = SafetyLimits(torque=38.0, jump_angle=0.004, sample_jitter=0.1, frozen_time=0.016, ground_height=0.03)
PER_METRE = 5000 / tau / ROBOT.boom_length
YAW, PITCH = "boom_horizontal", "boom_vertical"


def hops(change, gap=None, seed=0, most=22, limits=LIMITS):
    """Number of hops until the robot was stopped or had made enough, and its control; faults begin after 1.8 s."""
    rng = np.random.default_rng(seed)
    twin = Twin(ROBOT, gap or RealityGap(), rng)
    twin.connect()
    control, applied, made, number, command = (
        HopControl(twin.sensor_model, ROBOT, GAINS, limits),
        (0.0, 0.0),
        0,
        0,
        None,
    )
    while made < most:
        reading = twin.read()
        changed = change(number - 1800, reading) if number >= 1800 else reading
        order = Order(Mode.STEP, 1.0, command or (-4.0, -3.0))
        torques, flags = control.tick(number * TICK, changed, order, applied)
        if flags & (TickFlag.STOPPED | TickFlag.FAILED):
            break
        if flags & TickFlag.STEP_ENDED:
            made, command = made + 1, tuple(rng.uniform((-10.0, -9.0), (2.0, 3.0)).tolist())
        applied, number = twin.write(torques), number + 1
    return made, control


def scaled(sensor, factor):
    """Counts of a sensor that change by a factor too much."""
    first = []

    def change(_, reading):
        first.append(getattr(reading, sensor))
        return reading._replace(**{sensor: float(round(first[0] + factor * (first[-1] - first[0])))})

    return change


def drifting(speed):
    return lambda number, reading: reading._replace(
        **{YAW: float(round(reading.boom_horizontal + speed * TICK * number * PER_METRE))}
    )


def noisy(sensor, counts):
    rng = np.random.default_rng(5)
    return lambda _, reading: reading._replace(
        **{sensor: float(round(getattr(reading, sensor) + counts * rng.standard_normal()))}
    )


def stuck(sensor, bit, value):
    """Counts with a bit that has always the same value."""

    def change(_, reading):
        counts = int(getattr(reading, sensor))
        return reading._replace(**{sensor: float(counts | 1 << bit if value else counts & ~(1 << bit))})

    return change


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        *((scaled(YAW, factor), "yaw") for factor in (-1.0, 0.9, 1.1, 2.0)),
        *((drifting(speed), "yaw against leg") for speed in (-0.03, 0.03)),
        *((stuck(YAW, bit, bit % 2), "yaw noisy") for bit in (0, 1)),
        *((scaled(PITCH, factor), "") for factor in (-1.0, 0.9, 1.1)),
        *((noisy(PITCH, counts), "pitch") for counts in (1.0, 2.0)),
        *((stuck(PITCH, bit, bit % 2), "pitch") for bit in (0, 4)),
    ],
)
def test_a_wrong_size_of_yaw_or_pitch_stops_the_robot(change, reason):
    made, control = hops(change)
    assert made < 20
    assert control.status == StepStatus.DOUBTFUL
    assert reason in control.stopped


@pytest.mark.parametrize(
    ("seed", "floor"), [(0, {}), (103, {"ground_roughness": 3e-3, "ground_slope": 3e-3}), (405, {})]
)
def test_there_is_no_doubt_about_healthy_robots_also_on_uneven_floors_and_with_feet_that_slip(seed, floor):
    gap = RealityGap.random(np.random.default_rng(seed)) if seed else RealityGap()
    made, control = hops(lambda _, reading: reading, replace(gap, **floor), seed)
    assert (made, control.stopped) == (22, "")


def test_without_limits_nothing_is_doubted():
    made, control = hops(scaled(YAW, 0.5), most=8, limits=SafetyLimits(torque=38.0))
    assert (made, control.stopped) == (8, "")


@given(st.floats(-1.5, 1.5), st.floats(-0.3, 0.3), st.lists(st.floats(5.0, 500.0), min_size=40, max_size=80))
def test_the_slip_is_the_speed_of_the_foot_by_yaw_and_leg(speed, slip, forces):
    contact = Standing()
    for number, force in enumerate(forces):
        time = 0.3 + number * TICK
        contact = with_reading(contact, time, force, 2.0 + (speed + slip) * time, 0.1 - speed * time)
    assert slip_of(contact) == pytest.approx((slip, -speed), abs=1e-6)


def stances_until_doubt(scale, drift, speed, rng, most=3000):
    """Stances until there is evidence, for slips of normal noise and a yaw with errors of scale and drift [m/s]."""
    evidence = YawEvidence()
    for number in range(most):
        slip = rng.normal(0.0, 0.8 * SLIP_DEVIATION) + (scale - 1.0) * speed + drift
        evidence = with_slip(evidence, slip, -speed)
        if max(evidence.forward, evidence.backward, evidence.few, evidence.many) > MOST_EVIDENCE:
            return number + 1
    return most


@pytest.mark.parametrize("speed", [0.0, 0.1, 0.4, -0.4, 1.0])
def test_noise_alone_is_no_evidence(speed):
    assert stances_until_doubt(1.0, 0.0, speed, np.random.default_rng(1)) == 3000


@pytest.mark.parametrize("speed", [0.3, -0.3])
@pytest.mark.parametrize(("scale", "drift"), [(0.88, 0.0), (1.1, 0.0), (1.0, 0.03), (1.0, -0.03)])
def test_small_errors_of_scale_and_drifts_are_found_within_a_few_stances(scale, drift, speed):
    found = [stances_until_doubt(scale, drift, speed, np.random.default_rng(seed)) for seed in range(20)]
    assert max(found) <= 12


def test_one_foot_that_slips_is_no_evidence():
    evidence = YawEvidence()
    for number in range(40):
        evidence = with_slip(evidence, 0.16 if number == 20 else 0.0, 0.3)
        assert max(evidence.forward, evidence.backward, evidence.few, evidence.many) < MOST_EVIDENCE


def watched(readings):
    """`Counts` after readings, one a tick."""
    unit, track, counts = tau / 16384, EncoderTrack(), Counts()
    for number, value in enumerate(readings):
        track, jump = with_angle(track, TICK, unit, number * TICK, unit * value, 0.0, False)
        counts = with_count(counts, TICK, unit, value, track, jump)
    return counts


@given(st.floats(-3.0, 3.0), st.floats(0.0, 1.0), st.floats(-0.02, 0.02))
def test_rounding_alone_is_not_noisy_at_any_speed(speed, offset, acceleration):
    times = np.arange(400)
    counts = watched(np.rint(offset + speed * times + acceleration * times**2 / 2).tolist())
    assert not is_noisy(counts, 0.0)


@pytest.mark.parametrize("bit", range(4))
@pytest.mark.parametrize("zero", [0, 3, 1001])
def test_a_stuck_bit_is_found_whatever_the_zero(bit, zero):
    """The zero is subtracted from the counts before the tick sees them."""
    steps = np.arange(3000)
    assert not is_noisy(watched((steps // 10 - zero).tolist()), 0.0)
    assert is_noisy(watched((steps // 10 & ~(1 << bit)) - zero), 0.0)
    assert RESIDUES > 1 << 3


def test_two_counts_per_tick_are_no_stuck_bit():
    assert not is_noisy(watched((2 * np.arange(400)).tolist()), 0.0)


@given(st.floats(0.5, 2.0), st.floats(2.0, 6.0), st.floats(0.25, 0.6))
def test_the_time_after_the_vertex_is_that_of_the_parabola(speed, gravity, until):
    fit = FlightFit()
    for time in np.arange(0.0, until, TICK):
        fit = with_sample(fit, time, 0.0, 0.4 + speed * time - gravity * time**2 / 2)
    assert after_vertex(fit) == pytest.approx(fit.latest - speed / gravity, abs=1e-6)


def test_the_new_reasons_are_doubts_that_stop():
    for name in ("YAW_NOISY", "PITCH_NOISY", "PITCH_AGAINST_LEG", "PITCH_AGAINST_FLIGHT"):
        assert Limited[name] & DOUBTS
        assert Limited[name] & STOPS
    assert not DOUBTS & (Limited.OVERLOAD | Limited.POWER | Limited.EMERGENCY_STOP)


def test_travels_change_equally_while_the_foot_rests():
    """A body over a foot at rest moves as far by the boom as by the leg; in the air there is nothing to compare."""
    twin = Twin(ROBOT, RealityGap.none(), np.random.default_rng(0))
    robot_control = HopperControl(ROBOT, GAINS, None)  # pyright: ignore[reportArgumentType] the bounds are not needed
    tick = {"boom_horizontal": 0.0, "alpha_1": 0.1, "alpha_2": 1.0, "contact_force": 0.0, "measured_height": 0.3}
    assert robot_control.travels(twin, tick) == {}
    there = robot_control.travels(twin, tick | {"contact_force": 20.0})
    moved = {"contact_force": 20.0, "alpha_1": 0.0}
    leg = robot_control.travels(twin, tick | moved)["forward by leg"] - there["forward by leg"]
    assert leg > 0.01
    yaw = leg / ROBOT.boom_length
    counts = yaw * twin.sensor_model.boom_counts_horizontal / tau
    by_yaw = robot_control.travels(twin, tick | moved | {"boom_horizontal": counts})["forward by yaw"]
    assert by_yaw - there["forward by yaw"] == pytest.approx(leg)
