"""The apex map against an independent hop, and what it promises of failures, batches and threads.

`python -m benchmarks.map_accuracy` makes the same comparison on a thousand points and more.
"""

import os
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.hopper import Gains, RobotParameters
from stepgap.hopper.apex_map import SMALLEST_SHARE, ApexMap
from stepgap.hopper.dynamics import energy, impact, masses_of, terms
from stepgap.hopper.hop import GUARDS, STATES, Flight, Stance, Tolerances
from stepgap.hopper.joint_control import JointLaw, joint_law, landing_posture
from stepgap.hopper.leg import foot, four_bar, leg_of
from stepgap.hybrid.integrator import TIME_OUT, Tolerance, integrate, make_workspace, take_sides
from stepgap.step import Reason, StepFailed
from tests.hopper.reference_hop import Hopper, reference_hop

MAP = ApexMap()
TIGHT = Tolerances(flight=Tolerance(1e-11, 1e-12), stance=Tolerance(1e-11, 1e-12))
WIDE = np.array([[-3.0, 0.1, -300.0, -300.0], [3.0, 1.5, 300.0, 300.0]])


def points_of_use(seed: int, count: int):
    """Random (speed, height, fx, fy) in the range of use."""
    quantities = (*MAP.space.state, *MAP.space.command)
    lower, upper = [quantity.lower for quantity in quantities], [quantity.upper for quantity in quantities]
    return np.random.default_rng(seed).uniform(lower, upper, (count, 4))


def wide_points(seed: int, count: int):
    """Random points far beyond the range of use, where most hops fail."""
    return np.random.default_rng(seed).uniform(WIDE[0], WIDE[1], (count, 4))


def evaluate(apex_map: ApexMap, points):
    """Outcome at points (speed, height, fx, fy); shape (…, 4)."""
    return apex_map.evaluate(points[..., :2], points[..., 2:])


@cache
def hopper(robot: RobotParameters, gains: Gains) -> Hopper:
    """The independent hopper."""
    return Hopper(robot, gains)


def assert_reference_agrees(apex_map: ApexMap, points, relative: float) -> None:
    """Same reason, and next states equal relative to the larger of value and half the range of use."""
    outcome = evaluate(apex_map, points)
    for point, next_state, reason in zip(points, outcome.next_state, outcome.reason, strict=True):
        expected_reason, expected = reference_hop(hopper(apex_map.robot, apex_map.gains), point[:2], point[2:])
        assert (Reason(int(reason)), point.tolist()) == (expected_reason, point.tolist())
        scale = np.maximum(np.abs(expected), apex_map.space.state_scale)
        if reason == Reason.OK:
            assert np.abs((next_state - expected) / scale).max() < relative


def test_next_apex_is_the_reference_s_to_a_millionth() -> None:
    assert_reference_agrees(MAP, points_of_use(11, 12), 1e-6)


def test_so_it_is_with_motors_that_saturate_in_every_hop() -> None:
    weak = ApexMap(RobotParameters(torque_limit=10.0))
    points = points_of_use(12, 6)
    assert (np.abs(evaluate(weak, points).next_state - evaluate(MAP, points).next_state).max(axis=1) > 1e-4).all()
    assert_reference_agrees(weak, points, 3e-6)


@pytest.mark.parametrize("stiffness", [1800.0, 3500.0])
def test_so_it_is_with_another_leg_spring(stiffness) -> None:
    assert_reference_agrees(ApexMap(gains=Gains(stiffness=stiffness)), points_of_use(13, 3), 1e-6)


def test_far_outside_the_range_of_use_reasons_are_the_reference_s() -> None:
    points = wide_points(14, 15)
    assert len(np.unique(evaluate(MAP, points).reason)) >= 3
    assert_reference_agrees(MAP, points, 3e-6)


def test_tight_tolerances_leave_errors_far_below_those_of_the_default() -> None:
    assert_reference_agrees(ApexMap(tolerances=TIGHT), points_of_use(15, 4), 2e-10)


def test_reasons_do_not_depend_on_the_tolerance() -> None:
    points = wide_points(16, 400)
    outcome, fine = evaluate(MAP, points), evaluate(ApexMap(tolerances=TIGHT), points)
    assert (outcome.reason == fine.reason).all()
    assert np.nanmax(np.abs(outcome.next_state - fine.next_state)) < 1e-5


def test_next_state_is_nan_exactly_where_the_step_fails() -> None:
    outcome = evaluate(MAP, wide_points(17, 2000))
    assert (np.isnan(outcome.next_state).all(axis=-1) == (outcome.reason != Reason.OK)).all()
    assert (np.isfinite(outcome.next_state).all(axis=-1) == (outcome.reason == Reason.OK)).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("place", range(4))
def test_numbers_that_are_not_finite_are_invalid(place, value) -> None:
    point = np.array([0.2, 0.58, 0.0, 0.0])
    point[place] = value
    next_state, reason = evaluate(MAP, point)
    assert reason == Reason.INVALID
    assert np.isnan(next_state).all()
    with pytest.raises(StepFailed, match="invalid"):
        MAP(point[:2], point[2:])


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 4))
def test_any_finite_numbers_end_with_a_reason(point) -> None:
    next_state, reason = evaluate(MAP, np.array(point))
    assert int(reason) in set(Reason)
    assert np.isfinite(next_state).all() == (reason == Reason.OK)


@pytest.mark.parametrize(
    ("point", "reason"),
    [
        ([0.0, 0.25, 0, 0], Reason.FOOT_SCUFFED),  # the apex itself is in the ground
        ([8.0, 0.6, 0, 0], Reason.FELL),  # lands with the leg too far over
        ([0.2, 0.58, 0, -300], Reason.NO_TAKE_OFF),  # pulled down
        ([0.0, 1e4, 0, 0], Reason.NO_APEX),  # falls for longer than the limit
    ],
)
def test_a_failure_has_the_reason_that_one_would_give_it(point, reason) -> None:
    assert evaluate(MAP, np.array(point, float)).reason == reason


def test_a_leg_that_lands_longer_than_its_spring_is_pulled_off_the_ground() -> None:
    """The spring pulls at touchdown: a ground that never pulls lets go at once."""
    pulling = ApexMap(gains=Gains(rest_length=0.2, landing_length=0.3))
    points = points_of_use(18, 6)
    assert set(evaluate(pulling, points).reason) == {Reason.NO_TAKE_OFF}
    assert_reference_agrees(pulling, points[:2], 1e-6)


def test_a_foot_that_the_impact_throws_off_the_ground_is_not_held_by_it() -> None:
    """Heavy legs without a body: a stance that begins without load is over, or the ground would pull."""
    robot = RobotParameters(bottom_mass=2.0, body_mass=0.05, boom_inertia_vertical=0.0, torque_limit=8.0)
    gains = Gains(2539.0, 0.2718, 0.2716, speed_gain=0.173, position_gain=61.6, damping_gain=2.414)
    heavy, points = ApexMap(robot, gains), np.array([[1.567, 0.2998, -74.8, 10.1], [-2.17, 0.302, -118.0, -161.0]])
    assert evaluate(heavy, points[0]).reason == Reason.OK
    assert_reference_agrees(heavy, points, 1e-5)


def test_batch_is_its_single_steps_for_any_leading_shape() -> None:
    points = wide_points(19, 120)
    flat = evaluate(MAP, points)
    for shape in [(120,), (2, 60), (3, 1, 40), (0,), (4, 0)]:
        size = int(np.prod(shape))
        outcome = evaluate(MAP, points[:size].reshape(*shape, 4))
        assert outcome.next_state.shape == (*shape, 2)
        assert outcome.reason.shape == shape
        assert np.array_equal(outcome.next_state.reshape(-1, 2), flat.next_state[:size], equal_nan=True)
    for point, next_state, reason in zip(points[:20], *(part[:20] for part in flat), strict=True):
        single = evaluate(MAP, point)
        assert single.reason.shape == ()
        assert single.reason == reason
        assert np.array_equal(single.next_state, next_state, equal_nan=True)


def test_state_and_command_broadcast() -> None:
    points = points_of_use(20, 5)
    grid = MAP.evaluate(points[:, None, :2], points[None, :, 2:])
    assert grid.reason.shape == (5, 5)
    for i in range(5):
        assert np.array_equal(grid.next_state[i], MAP.evaluate(points[i, :2], points[:, 2:]).next_state)
    assert np.array_equal(grid.next_state[[0, 1, 2, 3, 4], [0, 1, 2, 3, 4]], evaluate(MAP, points).next_state)


def test_threads_change_no_bit(monkeypatch) -> None:
    points = wide_points(21, SMALLEST_SHARE * 8 + 3)
    outcomes = []
    for cores in (1, 2, 3, 8):
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        outcomes.append(evaluate(MAP, points))
    for outcome in outcomes[1:]:
        assert outcome.next_state.tobytes() == outcomes[0].next_state.tobytes()
        assert outcome.reason.tobytes() == outcomes[0].reason.tobytes()


def test_an_error_in_a_thread_is_raised(monkeypatch) -> None:
    def broken(*_):
        raise MemoryError

    monkeypatch.setattr("stepgap.hopper.apex_map._hop_all", broken)
    monkeypatch.setattr(os, "cpu_count", lambda: 2)
    with pytest.raises(MemoryError):
        evaluate(MAP, points_of_use(22, 4 * SMALLEST_SHARE))


def run(system, state, duration):
    """Integrates a piece with fine tolerance for a time, whatever the guards say."""
    work, left = make_workspace(STATES, GUARDS), duration
    take_sides(system, state, work)
    while True:
        elapsed, event = integrate(system, state, left, Tolerance(1e-12, 1e-13), work)
        left -= elapsed
        if event == TIME_OUT:
            return
        assert event >= 0


def without_torque() -> JointLaw:
    """Motors that do nothing."""
    return joint_law(RobotParameters(), Gains())._replace(
        stiffness=0.0, position_gain=0.0, damping_gain=0.0, torque_limit=1e9
    )


@pytest.mark.parametrize("seed", range(3))
def test_without_torque_flight_keeps_energy_and_forward_momentum(seed) -> None:
    rng, masses = np.random.default_rng(seed), masses_of(RobotParameters())
    state = np.array([0.0, 1.0, *rng.uniform([-0.3, 0.5], [0.3, 1.0]), *rng.normal(0, [1, 1, 3, 3])])

    def kept():
        m = terms(masses, four_bar(masses.leg, state[3]), *state[2:4], *state[6:])
        return energy(masses, state[:4], state[4:]), m.x * state[4] + m.x_1 * state[6] + m.x_2 * state[7]

    before = kept()
    run(Flight(masses, without_torque(), 0.0), state, 0.3)
    assert kept() == pytest.approx(before, rel=1e-9)


def test_in_stance_energy_with_the_spring_is_kept_until_the_command_and_the_foot_stays() -> None:
    """With the motors as an ideal spring, energy + ½ K₂ (ℓ − ℓ₀)² is constant; the pinned foot does not drift.

    The toe lies off the leg axis, so the motors are a spring along it only if there is no toe.
    """
    robot = RobotParameters(foot_length=0.0)
    masses, law, leg = masses_of(robot), joint_law(robot, Gains()), leg_of(robot)
    state = np.array([0.0, 0.25, *landing_posture(law, 0.3), 0.3, -1.0, 0.0, 0.0])
    bar = four_bar(leg, state[3])
    state[4:] = impact(terms(masses, bar, *state[2:4], *state[6:]), foot(leg, bar, state[2]), *state[4:])

    def kept():
        bar = four_bar(leg, state[3])
        toe = foot(leg, bar, state[2])
        spring = 0.5 * law.stiffness * (bar.length - law.rest_length) ** 2
        return energy(masses, state[:4], state[4:]) + spring, state[0] + toe.x, state[1] + toe.y

    before = kept()
    run(Stance(masses, law, 0.0, 0.0), state, 0.12)
    assert kept() == pytest.approx(before, abs=1e-9)


def test_jacobian_is_that_of_the_exact_map() -> None:
    points = points_of_use(23, 20)
    jacobian = MAP.jacobian(points[:, :2], points[:, 2:])
    exact = ApexMap(tolerances=TIGHT).jacobian(points[:, :2], points[:, 2:])
    size = np.concatenate([MAP.space.state_scale, MAP.space.command_scale])
    unit = size / MAP.space.state_scale[:, None]  # per half range of each, in half ranges
    assert np.abs((jacobian - exact) * unit).max() < 1e-5


def test_lengths_out_of_reach_are_refused() -> None:
    with pytest.raises(ValueError, match="landing_length"):
        ApexMap(gains=Gains(landing_length=0.32))
