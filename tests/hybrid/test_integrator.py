"""The integrator on motions with closed forms, reached as a robot reaches it: through `implements`."""

from math import asin, pi, sqrt
from typing import NamedTuple

import numpy as np
import pytest

from stepgap.hybrid import integrator
from stepgap.hybrid.compiled import implements
from stepgap.hybrid.integrator import BROKEN, TIME_OUT, Tolerance, guards, integrate, make_workspace, rate, take_sides

FINE, COARSE = Tolerance(1e-13, 1e-14), Tolerance(1e-6, 1e-6)
FREE_FALL, OSCILLATOR, SERVO, GROWTH, BLOW_UP, ROOT = range(6)


class Motion(NamedTuple):
    """A motion of (position, speed), with guards at two positions and at zero speed.

    Attributes:
        kind: FREE_FALL under gravity `a`; OSCILLATOR of angular frequency `a`; SERVO that pulls a unit
            mass back with stiffness `a` and at most unit force, whose second level is that saturation;
            GROWTH y' = y² cos t of (t, y); BLOW_UP y' = y²; ROOT y' = −√y.
        a: See `kind`.
        first: Position of guard 0.
        second: Position of guard 1.
    """

    kind: int
    a: float = 1.0
    first: float = -1e9
    second: float = -1e9


@implements(rate, Motion)
def _rate(system, state, out):
    out[0], out[1] = state[1], 0.0
    if system.kind == FREE_FALL:
        out[1] = -system.a
    elif system.kind == OSCILLATOR:
        out[1] = -(system.a**2) * state[0]
    elif system.kind == SERVO:
        out[1] = -min(1.0, max(-1.0, system.a * state[0]))
    elif system.kind == GROWTH:
        out[0], out[1] = 1.0, state[1] ** 2 * np.cos(state[0])
    elif system.kind == BLOW_UP:
        out[0], out[1] = state[0] ** 2, 0.0
    else:
        out[0], out[1] = -np.sqrt(state[0]), 0.0


@implements(guards, Motion)
def _guards(system, state, out):
    out[0] = state[0] - system.first
    out[1] = 1.0 - (system.a * state[0]) ** 2 if system.kind == SERVO else state[0] - system.second
    out[2] = state[1]


def run(motion, state, limit=100.0, tolerance=FINE, signs=None, work=None):
    """(elapsed, event, state) of one piece."""
    state = np.array(state, float)
    if work is None:
        work = make_workspace(2, 3)
        take_sides(motion, state, work)
    if signs is not None:
        work.signs[:] = signs
    elapsed, event = integrate(motion, state, limit, tolerance, work)
    return elapsed, event, state


def test_steps_are_of_order_five_and_their_error_estimate_too() -> None:
    start, sizes = np.array([0.3, 0.5]), 0.4 * 0.5 ** np.arange(5)
    errors, estimates = [], []
    for h in sizes:
        state, work, motion = start.copy(), make_workspace(2, 3), Motion(GROWTH)
        for step in range(round(1.6 / h)):
            rate_now = work.stages[0]
            rate_now[:] = 1.0, state[1] ** 2 * np.cos(state[0])
            integrator._step(motion, state, h, work)
            if step == 0:
                estimates.append(integrator._scaled_error(state, h, Tolerance(0.0, 1.0), work))
            state[:] = work.trial
        errors.append(abs(state[1] - 1 / (1 / 0.5 + np.sin(0.3) - np.sin(1.9))))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    assert order[-1] == pytest.approx(5, abs=0.3)
    assert np.log2(estimates[-2] / estimates[-1]) == pytest.approx(5, abs=0.3)


@pytest.mark.parametrize("relative", [1e-5, 1e-7, 1e-9, 1e-11])
def test_error_follows_the_tolerance(relative) -> None:
    _, event, state = run(Motion(OSCILLATOR, 3.0), [1, 0], 20.0, Tolerance(relative, relative), signs=[1, 1, 0])
    assert event == TIME_OUT
    assert np.abs(state - [np.cos(60), -3 * np.sin(60)]).max() < 300 * relative


def test_event_times_of_an_oscillator_match_the_closed_form() -> None:
    rng = np.random.default_rng(0)
    for omega, level in zip(rng.uniform(0.1, 30, 50), rng.uniform(-0.99, 0.99, 50), strict=True):
        elapsed, event, state = run(Motion(OSCILLATOR, omega, first=level), [1, 0], signs=[1, 1, -1])
        assert event == 0
        assert elapsed * omega == pytest.approx(pi / 2 - asin(level), abs=1e-11)
        assert state[0] == pytest.approx(level, abs=1e-12)


def test_a_coarse_tolerance_still_ends_on_the_guard() -> None:
    rng = np.random.default_rng(1)
    for level in rng.uniform(-0.9999, 0.9999, 50):
        _, event, state = run(Motion(OSCILLATOR, 1.0, first=level), [1, 0], tolerance=COARSE, signs=[1, 1, -1])
        assert event == 0
        assert state[0] == pytest.approx(level, abs=1e-12)


def test_elapsed_time_is_that_of_the_state_returned() -> None:
    """Free fall is integrated without error, whatever the step: position and speed tell the time."""
    rng = np.random.default_rng(2)
    for level in rng.uniform(0, 1, 50):
        elapsed, _, state = run(Motion(FREE_FALL, 9.81, first=level), [1, 0], tolerance=COARSE, signs=[1, 1, -1])
        assert -9.81 * elapsed == pytest.approx(state[1], rel=1e-14)
        assert state[1] == pytest.approx(-sqrt(2 * 9.81 * (1 - level)), rel=1e-11)


def test_bouncing_ball_bounces_when_the_closed_form_says() -> None:
    motion, state, work, restitution, times = Motion(FREE_FALL, 9.81, first=0.0), [1.0, 0.0], None, 0.8, []
    work = make_workspace(2, 3)
    for _ in range(20):
        elapsed, event, state = run(motion, state, work=work, signs=[1, 1, 0])
        assert event == 0
        times.append(elapsed)
        state = [0.0, -restitution * state[1]]
    first = sqrt(2 / 9.81)
    assert times == pytest.approx([first, *(2 * first * restitution**k for k in range(1, 20))], abs=1e-11)


def test_going_on_after_an_event_meets_the_next_one() -> None:
    """An oscillator crosses its centre and stands still in turns; every event once, none twice."""
    motion, work, state, total = Motion(OSCILLATOR, 2.0, first=0.0), make_workspace(2, 3), np.array([1.0, 0.0]), 0.0
    take_sides(motion, state, work)
    work.signs[2] = -1
    for k in range(40):
        elapsed, event = integrate(motion, state, 100.0, FINE, work)
        total += elapsed
        assert event == (0 if k % 2 == 0 else 2)
        assert total == pytest.approx((k + 1) * pi / 4, abs=1e-11)


def test_a_guard_fires_from_either_side_and_only_when_its_sign_changes() -> None:
    assert run(Motion(FREE_FALL, first=0.5), [1, 0], signs=[1, 1, -1])[1] == 0
    assert run(Motion(FREE_FALL, first=0.5), [0, 2], signs=[-1, 1, 1])[:2] == (pytest.approx(2 - sqrt(3)), 0)
    elapsed, event, _ = run(Motion(FREE_FALL, first=0.5 + 1e-9), [0, 1])  # goes up to 0.5
    assert (elapsed, event) == (pytest.approx(1), 2)


def test_zero_counts_as_the_lower_side_unless_the_caller_says_otherwise() -> None:
    rising = Motion(FREE_FALL, first=0.0)
    elapsed, event, _ = run(rising, [0, 1])
    assert event == 0
    assert elapsed == pytest.approx(0, abs=1e-12)
    elapsed, event, _ = run(rising, [0, 1], signs=[1, 1, 0])
    assert (elapsed, event) == (pytest.approx(2, abs=1e-11), 0)


def test_a_piece_that_begins_beyond_a_guard_ends_at_once() -> None:
    elapsed, event, state = run(Motion(FREE_FALL, first=1.0), [0, 0], signs=[1, 1, -1])
    assert event == 0
    assert elapsed < 1e-12
    assert state == pytest.approx([0, 0], abs=1e-12)


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-6, 1e-9])
def test_of_several_guards_in_one_step_the_earliest_wins(gap) -> None:
    higher, lower = 0.5 + gap, 0.5
    for first, second in [(higher, lower), (lower, higher)]:
        motion, work, state = Motion(FREE_FALL, first=first, second=second), make_workspace(2, 3), np.array([1.0, 0.0])
        take_sides(motion, state, work)
        work.signs[2] = -1
        earlier, event = integrate(motion, state, 10.0, COARSE, work)
        assert event == (0 if first == higher else 1)
        later, event = integrate(motion, state, 10.0, COARSE, work)
        assert event == (1 if first == higher else 0)
        assert [earlier, earlier + later] == pytest.approx([sqrt(2 * (1 - higher)), 1.0], abs=1e-11)


def test_a_guard_crossed_and_crossed_back_within_a_step_is_met() -> None:
    """A throw of 0.1 ms, the size of the first step, whose summit lies beyond the guard."""
    gravity, duration = 9.81, 1e-4
    speed = gravity * duration / 2
    summit = speed**2 / (2 * gravity)
    for part in (0.1, 0.5, 0.9, 0.99):
        motion = Motion(FREE_FALL, gravity, first=part * summit)
        elapsed, event, _ = run(motion, [0, speed], duration, signs=[-1, 1, 0])
        assert event == 0
        assert elapsed == pytest.approx(duration / 2 * (1 - sqrt(1 - part)), abs=1e-11)


def test_time_limit_is_kept_to_the_last_bit() -> None:
    for limit in (0.0, 1e-15, 1e-5, 0.1, 1 / 3, 7.7):
        elapsed, event, state = run(Motion(OSCILLATOR, 1.0), [1, 0], limit, signs=[1, 1, 0])
        assert (elapsed, event) == (limit, TIME_OUT)
        assert state[0] == pytest.approx(np.cos(limit), abs=1e-12)


@pytest.mark.parametrize(
    ("motion", "state"),
    [
        (Motion(BLOW_UP), [1, 0]),
        (Motion(ROOT), [1, 0]),
        (Motion(FREE_FALL), [np.nan, 0]),
        (Motion(FREE_FALL), [np.inf, 0]),
    ],
)
def test_what_ceases_to_be_finite_is_broken(motion, state) -> None:
    elapsed, event, _ = run(motion, state, signs=[0, 0, 0])
    assert event == BROKEN
    assert elapsed <= 2.0001


def test_a_kink_marked_by_a_guard_costs_no_accuracy() -> None:
    """A servo from x₀ beyond saturation: parabola, then arc of a circle in phase space, then parabola."""
    stiffness, start = 4.0, 2.0
    motion, state, work, kinks, left = Motion(SERVO, stiffness), np.array([start, 0.0]), make_workspace(2, 3), 0, 5.0
    take_sides(motion, state, work)
    work.signs[0] = work.signs[2] = 0
    while True:
        elapsed, event = integrate(motion, state, left, Tolerance(1e-10, 1e-10), work)
        left -= elapsed
        if event == TIME_OUT:
            break
        assert event == 1
        kinks += 1
    edge = 1 / stiffness
    speed, omega = sqrt(2 * (start - edge)), sqrt(stiffness)
    quarter, half = speed, 2 * np.arctan2(edge * omega, speed) / omega
    assert kinks == 2
    after = 5.0 - quarter - half  # since the mass left the linear band on the far side
    assert state == pytest.approx([-edge - speed * after + after**2 / 2, -speed + after], abs=1e-9)
