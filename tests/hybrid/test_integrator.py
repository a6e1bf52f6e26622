"""The integrator on motions with closed forms, implemented as those of a robot: through `implements`."""

from math import asin, pi, sqrt
from typing import NamedTuple

import numpy as np
import pytest

from stepgap.base.compiled import compiled, implements
from stepgap.hybrid.integrator import (
    BROKEN,
    TIME_OUT,
    Tolerance,
    integrate,
    make_trace,
    retrace,
    rewind,
)
from stepgap.hybrid.motion import rate, rate_and_guards, rate_jacobian

FINE, COARSE = Tolerance(1e-13, 1e-14), Tolerance(1e-6, 1e-6)
FREE_FALL, OSCILLATOR, BLOW_UP, ROOT = range(4)
NEVER = -1e9


@compiled
def integrated(system, time, state, time_limit, tolerance, h, trace):
    """`integrate`, compiled with a cache; without one, each process would compile it again."""
    return integrate(system, time, state, time_limit, tolerance, h, trace)


@compiled
def retraced(system, time, state, trace):
    """`retrace`, likewise with a cache."""
    return retrace(system, time, state, trace)


class Motion(NamedTuple):
    """A motion of (position, another, speed, another's), above two positions and on one side of zero speed.

    Attributes:
        kind: FREE_FALL under gravity `a`; OSCILLATOR of angular frequency `a`; BLOW_UP y' = y²; ROOT y' = −√y.
        a: See `kind`.
        first: Position of guard 0.
        second: Position of guard 1.
        side: Sign of the speed, 0 if it does not matter.
    """

    kind: int
    a: float = 1.0
    first: float = NEVER
    second: float = NEVER
    side: float = 0.0


@implements(rate, Motion)
def _rate(system, state):
    if system.kind == FREE_FALL:
        return state[2], state[3], -system.a, 0.0
    if system.kind == OSCILLATOR:
        return state[2], state[3], -(system.a**2) * state[0], 0.0
    if system.kind == BLOW_UP:
        return state[0] ** 2, 0.0, 0.0, 0.0
    return -np.sqrt(state[0]), 0.0, 0.0, 0.0


@implements(rate_and_guards, Motion)
def _rate_and_guards(system, time, state):
    guards = state[0] - system.first, state[0] - system.second, system.side * state[2]
    return rate(system, state), guards


@implements(rate_jacobian, Motion)
def _jacobian(system, state, here):
    return None


class Servo(NamedTuple):
    """A unit mass on a spring and a damper so strong that the motion is stiff; solved by the implicit method."""

    stiffness: float
    damping: float
    level: float = NEVER


@implements(rate, Servo)
def _servo_rate(system, state):
    return state[2], state[3], -system.stiffness * state[0] - system.damping * state[2], -state[1]


@implements(rate_and_guards, Servo)
def _servo_rate_and_guards(system, time, state):
    return rate(system, state), (state[0] - system.level,)


@implements(rate_jacobian, Servo)
def _servo_jacobian(system, state, here):
    return (-system.stiffness, 0.0, -system.damping, 0.0), (0.0, -1.0, 0.0, 0.0)


def run(motion, position, speed=0.0, limit=100.0, tolerance=FINE, first_step=1e-4, trace=None):
    """(time, event, position, speed) of one piece."""
    trace = make_trace() if trace is None else trace
    time, state, event, _ = integrated(motion, 0.0, (position, 0.0, speed, 0.0), limit, tolerance, first_step, trace)
    return time, event, state[0], state[2]


@pytest.mark.parametrize("relative", [1e-5, 1e-7, 1e-9, 1e-11])
def test_error_follows_the_tolerance(relative) -> None:
    _, event, position, speed = run(Motion(OSCILLATOR, 3.0), 1.0, 0.0, 20.0, Tolerance(relative, relative))
    assert event == TIME_OUT
    assert np.abs([position - np.cos(60), speed + 3 * np.sin(60)]).max() < 300 * relative


@pytest.mark.parametrize("relative", [1e-4, 1e-6, 1e-8, 1e-10])
def test_error_of_stiff_motion_follows_the_tolerance_in_few_steps(relative) -> None:
    """Poles near −1 and −10⁴: an explicit method needs thousands of steps."""
    poles, trace = np.array([1.0, 1e4]), make_trace()
    servo, limit = Servo(poles.prod(), poles.sum()), 1.0
    _, event, position, _ = run(servo, 1.0, 0.0, limit, Tolerance(relative, relative), 1e-3, trace)
    exact = (poles[1] * np.exp(-poles[0] * limit) - poles[0] * np.exp(-poles[1] * limit)) / (poles[1] - poles[0])
    assert event == TIME_OUT
    assert abs(position - exact) < 30 * relative
    assert trace.cursor[0] < 400


def test_both_methods_are_of_order_five() -> None:
    for motion, exact in [(Motion(OSCILLATOR, 2.0), np.cos(2.0)), (Servo(4.0, 0.0), np.cos(2.0))]:
        errors = []
        for steps in (8, 16, 32):
            position, speed = 1.0, 0.0
            for _ in range(steps):
                everything = Tolerance(0.0, 1e9)
                _, _, position, speed = run(motion, position, speed, 1.0 / steps, everything, 1.0 / steps)
            errors.append(abs(position - exact))
        assert np.log2(errors[1] / errors[2]) > 4.5


def test_event_times_of_an_oscillator_match_the_closed_form() -> None:
    rng = np.random.default_rng(0)
    for omega, level in zip(rng.uniform(0.1, 30, 50), rng.uniform(-0.99, 0.99, 50), strict=True):
        time, event, position, _ = run(Motion(OSCILLATOR, omega, first=level, side=-1.0), 1.0)
        assert event == 0
        assert time * omega == pytest.approx(pi / 2 - asin(level), abs=1e-11)
        assert position == pytest.approx(level, abs=1e-12)


def test_a_coarse_tolerance_still_ends_on_the_guard() -> None:
    for level in np.random.default_rng(1).uniform(-0.9999, 0.9999, 50):
        _, event, position, _ = run(Motion(OSCILLATOR, 1.0, first=level), 1.0, tolerance=COARSE)
        assert event == 0
        assert position == pytest.approx(level, abs=1e-12)


def test_time_is_that_of_the_state_returned() -> None:
    """Free fall is integrated without error for any step: position and speed determine the time."""
    for level in np.random.default_rng(2).uniform(0, 1, 50):
        time, _, _, speed = run(Motion(FREE_FALL, 9.81, first=level), 1.0, tolerance=COARSE)
        assert -9.81 * time == pytest.approx(speed, rel=1e-12)
        assert speed == pytest.approx(-sqrt(2 * 9.81 * (1 - level)), rel=1e-11)


def test_bouncing_ball_bounces_at_the_times_of_the_closed_form() -> None:
    motion, position, speed, restitution, times = Motion(FREE_FALL, 9.81, first=0.0), 1.0, 0.0, 0.8, []
    for _ in range(20):
        time, event, position, speed = run(motion, position, speed)
        assert event == 0
        times.append(time)
        speed = -restitution * speed
    first = sqrt(2 / 9.81)
    assert times == pytest.approx([first, *(2 * first * restitution**k for k in range(1, 20))], abs=1e-11)


def test_the_zero_of_a_guard_at_the_start_of_a_piece_is_no_event() -> None:
    """Half an oscillation from the level at which it began, to the same level."""
    for speed in (0.1, 1.0, 10.0):
        time, event, position, _ = run(Motion(OSCILLATOR, 2.0, first=0.0), 0.0, speed)
        assert (time, event) == (pytest.approx(pi / 2, abs=1e-11), 0)
        assert position == pytest.approx(0.0, abs=1e-12)


def test_a_piece_that_begins_beyond_a_guard_or_leaves_to_its_wrong_side_ends_at_once() -> None:
    for position, speed in [(0.0, 0.0), (1.0, -1.0)]:
        time, event, end, _ = run(Motion(FREE_FALL, first=1.0), position, speed)
        assert event == 0
        assert time < 1e-12
        assert end == pytest.approx(position, abs=1e-12)


@pytest.mark.parametrize("gap", [1e-1, 1e-3, 1e-6, 1e-9])
def test_of_several_guards_in_one_step_the_earliest_ends_the_piece(gap) -> None:
    for order in (1, -1):
        first, second = (0.5 + gap, 0.5)[::order]
        time, event, _, _ = run(Motion(FREE_FALL, first=first, second=second), 1.0, tolerance=COARSE)
        assert event == (0 if first > second else 1)
        assert time == pytest.approx(sqrt(2 * (0.5 - gap)), abs=1e-11)


def test_a_guard_that_is_negative_only_within_a_step_is_detected() -> None:
    """A throw as long as the first step, with a ceiling above its summit; as a floor, upside down."""
    gravity, duration = 9.81, 1e-2
    for begin in (0.0, 0.2, 0.4):  # the summit in the middle of the step or later
        top = (0.5 + begin / 2) * duration
        for part in (0.1, 0.5, 0.9, 0.99):
            depth = gravity * top**2 / 2
            motion = Motion(FREE_FALL, -gravity, first=-part * depth)
            time, event, _, _ = run(motion, 0.0, -gravity * top, duration, COARSE, duration)
            assert event == 0
            assert time == pytest.approx(top * (1 - sqrt(1 - part)), abs=1e-11)


def test_time_limit_is_kept_to_the_last_bit() -> None:
    for limit in (1e-15, 1e-5, 0.1, 1 / 3, 7.7):
        time, event, position, _ = run(Motion(OSCILLATOR, 1.0), 1.0, 0.0, limit)
        assert (time, event) == (pytest.approx(limit, rel=1e-15), TIME_OUT)
        assert position == pytest.approx(np.cos(limit), abs=1e-12)


@pytest.mark.parametrize(
    ("motion", "position"),
    [(Motion(BLOW_UP), 1.0), (Motion(ROOT), 1.0), (Motion(FREE_FALL), np.nan), (Motion(FREE_FALL), np.inf)],
)
def test_a_state_that_becomes_infinite_is_broken(motion, position) -> None:
    time, event, _, _ = run(motion, position)
    assert event == BROKEN
    assert time <= 2.0001


def test_more_steps_than_the_trace_holds_are_broken() -> None:
    assert run(Motion(OSCILLATOR, 1e3), 1.0, 0.0, 1e3)[1] == BROKEN


@pytest.mark.parametrize("motion", [Motion(OSCILLATOR, 3.0, first=0.3), Servo(4e4, 250.0, 0.3)])
def test_a_retraced_motion_is_itself_and_its_neighbour_differs_by_the_derivative(motion) -> None:
    """Time to a level of a linear motion from `position` at rest: a function of level/position alone."""
    trace, nudge = make_trace(), 1e-7
    start = (1.0, 0.0, 0.0, 0.0)
    time, state, _, _ = integrated(motion, 0.0, start, 100.0, FINE, 1e-4, trace)
    rewind(trace)
    again, same, event = retraced(motion, 0.0, start, trace)
    assert (again, same, event) == (pytest.approx(time, rel=1e-13), pytest.approx(state, abs=1e-13), 0)
    rewind(trace)
    later, neighbour, _ = retraced(motion, 0.0, (1.0 + nudge, 0.0, 0.0, 0.0), trace)
    level = 0.3
    assert neighbour[0] == pytest.approx(level, abs=1e-12)
    assert (later - time) / nudge == pytest.approx(-level / state[2], rel=1e-5)


def test_retracing_a_sequence_of_pieces_has_the_same_events() -> None:
    """A ball that bounces five times; the time of the last bounce grows with √height."""
    trace, motion, restitution = make_trace(), Motion(FREE_FALL, 9.81, first=0.0), 0.7

    def last_bounce(height, again):
        rewind(trace)
        time, state = 0.0, (height, 0.0, 0.0, 0.0)
        for _ in range(5):
            if again:
                time, state, event = retraced(motion, time, state, trace)
            else:
                time, state, event, _ = integrated(motion, time, state, 100.0, COARSE, 1e-3, trace)
            assert event == 0
            state = (0.0, 0.0, -restitution * state[2], 0.0)
        return time

    time, nudge = last_bounce(1.0, again=False), 1e-7
    assert (last_bounce(1.0 + nudge, again=True) - time) / nudge == pytest.approx(time / 2, rel=1e-6)
