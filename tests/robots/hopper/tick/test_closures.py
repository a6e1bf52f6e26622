"""Yaw and pitch compared in size with leg and flight: exact on ideal motion, silent without faults, sure with them."""

from dataclasses import replace
from math import tau

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.tick.closures import (
    ALLOWED_FIT,
    BAND,
    DISK_PRIOR,
    ECCENTRIC,
    FORGOTTEN,
    LEARNED,
    MOST_EVIDENCE,
    SLIP_DEVIATION,
    SlipFit,
    Standing,
    Steady,
    YawEvidence,
    slip_of,
    steady_with,
    suspicions,
    with_slip,
    with_stance,
)
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


def walking(counts):
    """Counts of the yaw that are lost or counted twice at random, in one of twenty ticks."""
    rng = np.random.default_rng(6)
    lost = [0.0]

    def change(_, reading):
        lost[0] += counts * rng.choice((-1, 1)) * (rng.random() < 0.05)
        return reading._replace(boom_horizontal=reading.boom_horizontal + lost[0])

    return change


def shifted(degrees):
    """A zero of the pitch that jumps."""
    return lambda _, reading: reading._replace(boom_vertical=reading.boom_vertical + round(16384 * degrees / 360))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (walking(2), "yaw noisy"),
        *((scaled(PITCH, factor), "pitch") for factor in (0.93, 1.07)),
        (shifted(0.2), "pitch jumped"),
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


def doubted_at(values, least=0.0025, at_first=0.015):
    """Number of the first value that is not like the others; None if all are."""
    steady = Steady()
    for number, value in enumerate(values):
        steady, is_off = steady_with(steady, value, least, at_first)
        if is_off:
            return number
    return None


@pytest.mark.parametrize("scatter", [0.0003, 0.003])
def test_a_band_is_learned_from_the_first_values(scatter):
    """A step of 6.8 mm is seen on a good floor, one of twelve deviations on any; noise alone is never off."""
    for seed in range(20):
        values = np.random.default_rng(seed).normal(0.002, scatter, 300)
        assert doubted_at(values) is None
        after = values + np.where(np.arange(300) >= 2 * LEARNED, max(0.0068, 2 * BAND * scatter), 0.0)
        assert doubted_at(after) == 2 * LEARNED + 1


def test_a_band_that_holds_from_the_first_values_shows_a_step_in_the_second_one_after_it():
    values = np.random.default_rng(1).normal(-4.0, 0.004, 30)
    for begin in range(2, 30 - 1):
        assert doubted_at(values * np.where(np.arange(30) >= begin, 0.96, 1.0), 0.04, 0.04) == begin + 1


def test_one_value_alone_is_never_off():
    for number in range(30):
        assert doubted_at(0.02 * (np.arange(30) == number)) is None


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


def stances_until_doubt(scale, drift, speed, rng, most=3000, slope=None):
    """Stances until there is evidence, for slips of normal noise and a yaw with errors of scale and drift [m/s].

    On ramps of a slope, each five stances long, the foot slips downhill by 0.8 m/s per slope.
    """
    evidence = YawEvidence()
    for number in range(most):
        here = (slope or 0.0) * (1 if number // 5 % 2 else -1)
        slip = rng.normal(0.0, 0.8 * SLIP_DEVIATION) + (scale - 1.0) * speed + drift - 0.8 * here
        evidence = with_slip(evidence, slip, -speed, int(slope is not None), here)
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


@pytest.mark.parametrize("speed", [0.1, 0.5, -0.5])
def test_a_foot_that_slips_down_measured_ramps_is_no_evidence_and_hides_no_wrong_scale(speed):
    assert stances_until_doubt(1.0, 0.0, speed, np.random.default_rng(1), slope=0.1) == 3000
    if abs(speed) > 0.2:
        found = [stances_until_doubt(0.75, 0.0, speed, np.random.default_rng(seed), slope=0.05) for seed in range(20)]
        assert max(found) <= 30


def test_suspicions_are_standard_deviations_of_weighted_least_squares():
    rng = np.random.default_rng(0)
    quantities = np.column_stack([rng.uniform(0.2, 1.0, 60), rng.normal(0.0, 0.3, (60, 2))])
    slips = quantities @ (0.1, 0.02, 0.0) + rng.normal(0.0, 0.01, 60)
    fit = SlipFit()
    for row, slip in zip(quantities, slips, strict=True):
        fit = with_stance(fit, slip, *row, 0.0)
    weights = (1.0 - FORGOTTEN) ** np.arange(59, -1, -1)
    noise = SLIP_DEVIATION**2
    precision = (quantities.T * weights) @ quantities + np.diag([noise / 0.1**2, noise / 0.03**2, noise / 0.03**2])
    right = np.linalg.solve(precision, (quantities.T * weights) @ slips)
    left = weights @ slips**2 - right @ ((quantities.T * weights) @ slips)
    covariance = np.linalg.inv(precision) * max(noise, left / (weights.sum() - 3))
    scale = (abs(right[0]) - ALLOWED_FIT) / np.sqrt(covariance[0, 0])
    others = np.sqrt(right[1:] @ np.linalg.solve(covariance[1:, 1:], right[1:]))
    assert suspicions(fit, 0.03, 0.03) == pytest.approx((scale, others))


def most_suspicion(eccentric, speed, seed):
    """Largest suspicion of a disk with this eccentricity [rad], in 60 hops of 0.6 s on a boom of 1.86 m."""
    rng = np.random.default_rng(seed)
    fit = SlipFit()
    most = 0.0
    for number in range(60):
        yaw = 0.6 * speed * number / 1.86
        slip = (0.02 + eccentric * np.cos(yaw + 1.0)) * speed + rng.normal(0.0, SLIP_DEVIATION)
        fit = with_stance(fit, slip, speed, speed * np.cos(yaw), speed * np.sin(yaw), 0.0)
        most = max(most, suspicions(fit, DISK_PRIOR, DISK_PRIOR)[1])
    return most


def test_an_eccentric_disk_is_told_from_feet_that_slip_if_the_robot_goes_round():
    assert min(most_suspicion(np.radians(1.0), 1.2, seed) for seed in range(20)) > ECCENTRIC
    assert max(most_suspicion(0.0, speed, seed) for speed in (0.1, 0.5, 1.2) for seed in range(20)) < ECCENTRIC


def test_evidence_is_handed_on_to_the_next_deployment_unless_the_robot_was_stopped_by_a_doubt():
    _, before = hops(lambda _, reading: reading, most=4)
    after = HopControl(Twin(ROBOT, RealityGap(), np.random.default_rng(0)).sensor_model, ROBOT, GAINS, LIMITS)
    assert before.evidence != after.evidence
    after.resume(before.evidence)
    assert after.evidence == before.evidence
    assert after.state.sensors.closures.fall == before.state.sensors.closures.fall
    after.resume(())
    assert after.evidence == before.evidence
    _, doubted = hops(noisy(PITCH, 5.0), most=4)
    assert doubted.evidence == ()


def test_one_foot_that_slips_is_no_evidence():
    evidence = YawEvidence()
    for number in range(40):
        evidence = with_slip(evidence, 0.16 if number == 20 else 0.0, 0.3, 0, 0.0)
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
