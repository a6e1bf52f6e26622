"""Drives that report their commands and give other torques are found by the motion of the leg; healthy twins hop on."""

import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.rigs.rig import HEALTHY, LOST
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.dynamics import flight_acceleration, masses_of, stance_acceleration, terms
from stepgap.robots.hopper.model.leg import foot, four_bar
from stepgap.robots.hopper.tick.drive_motion import GRIP, _moving_torques
from stepgap.robots.hopper.tick.estimator import JointRates
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.safety import JointMotion
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus

ROBOT = RobotParameters()
MASSES = masses_of(ROBOT)
LIMITS = SafetyLimits(torque=38.0, motion_torque=2.0, lost_frames=5, stale_ticks=5)
TICK = 1e-3
BEGIN = 3300  # Tick in which a fault begins, after more than three stances


def hops(gap, seed, give, hops_made, loss=0.0, limits=LIMITS, tick=TICK):
    """Control at the end, ticks from the first torque that is wrong by 1 N·m, and hops.

    `give(torques, ticks since BEGIN, commands before)` are the torques that drives give which report their commands.
    """
    rng = np.random.default_rng(seed)
    twin = Twin(ROBOT, gap, rng, tick=tick)
    twin.connect()
    control = HopControl(twin.sensor_model, ROBOT, Gains(), limits)
    reading, applied, made, command, sent, wrong = twin.read(), (0.0, 0.0), 0, (-4.0, -3.0), [], 0
    while made < hops_made:
        is_lost = rng.random() < loss
        reading = reading if is_lost else twin.read()
        order = Order(Mode.STEP, 1.0, command)
        applied, flags = control.tick(len(sent) * tick, reading, order, applied, LOST if is_lost else HEALTHY)
        if flags & (TickFlag.STOPPED | TickFlag.FAILED):
            break
        if flags & TickFlag.STEP_ENDED:
            made, command = made + 1, (rng.uniform(-10, 2), rng.uniform(-9, 3))
        sent.append(applied)
        given = give(applied, sent) if len(sent) * tick > BEGIN * TICK else applied
        wrong += wrong > 0 or max(abs(a - b) for a, b in zip(given, applied, strict=True)) > 1.0
        twin.write(given)
    return control, wrong, made


FAULTS = {
    "motor 1 inverted": (lambda now, sent: (-now[0], now[1]), "motor 1 disobeys", 20, 45),
    "motor 2 inverted": (lambda now, sent: (now[0], -now[1]), "motor 2 disobeys", 20, 45),
    "both inverted": (lambda now, sent: (-now[0], -now[1]), "motor 1 disobeys, motor 2 disobeys", 20, 50),
    "motor 1 gives 38 N·m": (lambda now, sent: (-38.0, now[1]), "motor 1 disobeys", 20, 40),
    "3 ms late": (lambda now, sent: sent[-4], "", 250, 40),
    "twice": (lambda now, sent: (2 * now[0], now[1]), "motor 1 disobeys", 1000, 60),
    "half": (lambda now, sent: (now[0], 0.5 * now[1]), "", 1000, 80),
    "both saturate": (lambda now, sent: tuple(np.clip(now, -6.0, 6.0).tolist()), "", 1000, 80),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_drive_that_gives_another_torque_than_it_reports_stops_the_robot(fault):
    give, reason, ticks, speed = FAULTS[fault]
    control, wrong, _ = hops(RealityGap(), 0, give, 8)
    assert reason in control.stopped
    assert "disobeys (motor 1 was commanded " in control.stopped
    assert control.status is StepStatus.DOUBTFUL
    assert 0 < wrong <= ticks
    assert abs(control.motion.rate_1) + abs(control.motion.rate_2) < speed


def test_the_sentence_says_what_was_commanded_and_what_the_leg_did():
    control, _, _ = hops(RealityGap(), 0, lambda now, sent: (-38.0, now[1]), 8)
    numbers = re.search(r"motor 1 was commanded (\S+) N·m and moved as by (\S+), motor 2", control.stopped)
    assert numbers
    commanded, moved = map(float, numbers.groups())
    assert abs(commanded) < 10
    assert moved < -10, "the filter has not yet reached the −38 N·m"
    assert control.stopped.endswith("or else an encoder or the contact force is wrong)")


@pytest.mark.parametrize(
    ("seed", "scale", "tick", "torque"),
    [(0, 1.0, 1e-3, 2.0), (104, 1.0, 1e-3, 2.0), (106, 0.85, 1e-3, 2.0), (703, 1.0, 2e-3, 6.0)],
)
def test_healthy_twins_hop_on(seed, scale, tick, torque):
    """With lost frames, and if both torques change by 15 %, as they do with the temperature of the motors."""
    gap = RealityGap.random(np.random.default_rng(seed)) if seed else RealityGap()
    limits = replace(LIMITS, motion_torque=torque)
    control, _, made = hops(
        gap, seed, lambda now, sent: (scale * now[0], scale * now[1]), 12, loss=0.03, limits=limits, tick=tick
    )
    assert (made, control.stopped) == (12, "")


def test_without_the_limit_no_drive_is_judged():
    control, _, _ = hops(
        RealityGap(), 0, lambda now, sent: (-now[0], now[1]), 8, limits=replace(LIMITS, motion_torque=np.inf)
    )
    assert "disobeys" not in control.stopped


numbers = st.floats(-1.0, 1.0)


@given(st.tuples(*[numbers] * 6), st.booleans())
def test_the_torques_of_a_motion_are_those_that_cause_it(numbers, grounded):
    """The inverse of the equations of motion: in flight (Eq. 5), and with the foot pinned (Eq. 4)."""
    alpha_1, alpha_2 = 0.4 * numbers[0], 1.0 + 0.4 * numbers[1]
    rate_1, rate_2 = 10.0 * numbers[2], 10.0 * numbers[3]
    torques = 15.0 * numbers[4], 15.0 * numbers[5]
    bar = four_bar(MASSES.leg, alpha_2)
    toe = foot(MASSES.leg, bar, alpha_1)
    m = terms(MASSES, bar, alpha_1, alpha_2, rate_1, rate_2)
    if grounded:
        _, _, acc_1, acc_2, force_x, force = stance_acceleration(m, toe, rate_1, rate_2, *torques)
        assume(abs(force_x) < GRIP * force)
    else:
        _, _, acc_1, acc_2 = flight_acceleration(m, *torques)
        force = 0.0
    bend_1, bend_2 = 0.5 * acc_1 * TICK**2, 0.5 * acc_2 * TICK**2
    rates = JointRates(
        readings=2, time=1.0, alpha_1=alpha_1, alpha_2=alpha_2, time_before=1.0 - TICK,
        alpha_1_before=alpha_1 - rate_1 * TICK + bend_1, alpha_2_before=alpha_2 - rate_2 * TICK + bend_2,
    )  # fmt: skip
    latest = JointMotion(alpha_1 + rate_1 * TICK + bend_1, alpha_2 + rate_2 * TICK + bend_2, 0.0, 0.0, 0.0, 0.0)
    moved_1, moved_2, k = _moving_torques(MASSES, rates, TICK, latest, force, grounded)
    assert moved_1 == pytest.approx(torques[0] + torques[1], abs=1e-4)
    assert moved_2 == pytest.approx(torques[0] - torques[1], abs=1e-4)
    assert k == (pytest.approx(toe.x_2 / toe.x_1) if grounded else 0.0)
