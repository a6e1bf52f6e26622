"""The apex map compared with an independent hop, and its behaviour for failures, batches and threads."""

import os

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from stepgap.hybrid.integrator import Tolerance
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import SMALLEST_SHARE, ApexMap
from stepgap.robots.hopper.model.hop import Tolerances
from stepgap.step import StepFailed, StepStatus, difference_jacobian
from tests.robots.hopper.model.reference_answers import (
    CASES,
    COMMAND_LINE,
    compute_answer,
    points_of_use,
    stored_answers,
    wide_points,
)

MAP = ApexMap()
TIGHT = Tolerances(flight=Tolerance(1e-11, 1e-12), stance=Tolerance(1e-11, 1e-12))


def evaluate(apex_map: ApexMap, points):
    """Outcome at points (speed, height, fx, fy); shape (…, 4)."""
    return apex_map.evaluate(points[..., :2], points[..., 2:])


def test_stored_answers_of_the_reference_are_its_answers() -> None:
    """The hops differ in every run; the message of a failure names them."""
    rng = np.random.default_rng()
    for name in rng.choice(list(CASES), 2, replace=False):
        case, answers = CASES[name], stored_answers(name)
        which = rng.integers(len(case.points))
        computed, stored = compute_answer(case, case.points[which]), answers[which]
        hop = f"hop {which} of '{name}': after a change of the reference, run {COMMAND_LINE}"
        assert computed.status == stored.status, hop
        np.testing.assert_allclose(computed.next_state, stored.next_state, rtol=1e-9, err_msg=hop)


@pytest.mark.parametrize(
    ("name", "relative", "tolerances"),
    [
        ("range of use", 1e-6, MAP.tolerances),
        ("saturated motors", 1e-6, MAP.tolerances),
        ("soft spring", 1e-6, MAP.tolerances),
        ("stiff spring", 1e-6, MAP.tolerances),
        ("far outside", 3e-6, MAP.tolerances),
        ("tight tolerances", 2e-10, TIGHT),
        (
            "pulling spring",
            1e-6,
            MAP.tolerances,
        ),  # the ground cannot pull: the stance ends at once
        ("heavy legs", 1e-5, MAP.tolerances),  # without a body: a stance that begins without load ends
    ],
)
def test_status_and_next_apex_are_those_of_the_reference(name: str, relative: float, tolerances: Tolerances) -> None:
    """Next states are equal relative to the larger of value and half the range."""
    case = CASES[name]
    apex_map = ApexMap(case.robot, case.gains, tolerances=tolerances)
    outcome, answers = evaluate(apex_map, case.points), stored_answers(name)
    for point, next_state, status, (expected_status, expected) in zip(
        case.points, outcome.next_state, outcome.status, answers, strict=True
    ):
        assert (StepStatus(int(status)), point.tolist()) == (expected_status, point.tolist())
        scale = np.maximum(np.abs(expected), apex_map.space.state_scale)
        if status == StepStatus.OK:
            assert np.abs((next_state - expected) / scale).max() < relative


def test_the_cases_of_the_reference_have_what_they_are_named_after() -> None:
    weak, points = CASES["saturated motors"].robot, CASES["saturated motors"].points
    assert (np.abs(evaluate(ApexMap(weak), points).next_state - evaluate(MAP, points).next_state).max(1) > 1e-4).all()
    assert len({answer.status for answer in stored_answers("far outside")}) >= 3
    assert {answer.status for answer in stored_answers("pulling spring")} == {StepStatus.NO_TAKE_OFF}
    assert stored_answers("heavy legs")[0].status == StepStatus.OK


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("index", range(4))
def test_numbers_that_are_not_finite_are_invalid(index, value) -> None:
    point = np.array([0.2, 0.58, 0.0, 0.0])
    point[index] = value
    next_state, status = evaluate(MAP, point)
    assert status == StepStatus.INVALID
    assert np.isnan(next_state).all()
    with pytest.raises(StepFailed, match="invalid"):
        MAP(point[:2], point[2:])


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.tuples(*[st.floats(allow_nan=False, allow_infinity=False)] * 4))
def test_any_finite_numbers_give_a_status(point) -> None:
    next_state, status = evaluate(MAP, np.array(point))
    assert int(status) in set(StepStatus)
    assert np.isfinite(next_state).all() == (status == StepStatus.OK)


@pytest.mark.parametrize(
    ("point", "status"),
    [
        ([0.0, 0.25, 0, 0], StepStatus.FOOT_SCUFFED),  # the apex itself is in the ground
        ([8.0, 0.6, 0, 0], StepStatus.FELL),  # lands with the leg too far over
        ([0.2, 0.58, 0, -300], StepStatus.NO_TAKE_OFF),  # pulled down
        ([0.0, 1e4, 0, 0], StepStatus.NO_APEX),  # falls for longer than the limit
    ],
)
def test_a_failure_has_the_expected_status(point, status) -> None:
    assert evaluate(MAP, np.array(point, float)).status == status


def test_batch_is_its_single_steps_for_any_leading_shape() -> None:
    points = wide_points(19, 120)
    flat = evaluate(MAP, points)
    for shape in [(120,), (2, 60), (3, 1, 40), (0,), (4, 0)]:
        size = int(np.prod(shape))
        outcome = evaluate(MAP, points[:size].reshape(*shape, 4))
        assert outcome.next_state.shape == (*shape, 2)
        assert outcome.status.shape == shape
        assert np.array_equal(outcome.next_state.reshape(-1, 2), flat.next_state[:size], equal_nan=True)
    for point, next_state, status in zip(points[:20], *(part[:20] for part in flat), strict=True):
        single = evaluate(MAP, point)
        assert single.status.shape == ()
        assert single.status == status
        assert np.array_equal(single.next_state, next_state, equal_nan=True)


def test_state_and_command_broadcast() -> None:
    points = points_of_use(20, 5)
    grid = MAP.evaluate(points[:, None, :2], points[None, :, 2:])
    assert grid.status.shape == (5, 5)
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
        assert outcome.status.tobytes() == outcomes[0].status.tobytes()


def richardson(apex_map: ApexMap, points):
    """Jacobian of the map at tight tolerance by central differences, extrapolated to a step of zero."""
    fine = ApexMap(apex_map.robot, apex_map.gains, tolerances=TIGHT)
    wide, narrow = (difference_jacobian(fine, points[:, :2], points[:, 2:], step) for step in (2e-4, 1e-4))
    return (4 * narrow - wide) / 3


@pytest.mark.parametrize("torque_limit", [40.0, 10.0])
def test_jacobian_is_that_of_the_exact_map(torque_limit) -> None:
    apex_map, points = ApexMap(RobotParameters(torque_limit=torque_limit)), points_of_use(23, 50)
    jacobian, exact = apex_map.jacobian(points[:, :2], points[:, 2:]), richardson(apex_map, points)
    error = np.abs(jacobian - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    assert error.max() < 1e-5


def test_jacobian_is_nan_exactly_where_the_step_fails() -> None:
    points = wide_points(24, 200)
    points[::2] = points_of_use(24, 100)
    jacobian = MAP.jacobian(points[:, :2], points[:, 2:])
    assert (np.isnan(jacobian).all(axis=(1, 2)) == (evaluate(MAP, points).status != StepStatus.OK)).all()
    assert (np.isnan(jacobian).any(axis=(1, 2)) == np.isnan(jacobian).all(axis=(1, 2))).all()


def test_points_with_the_same_state_give_the_same_as_each_alone() -> None:
    points = points_of_use(25, 12)
    points[:, :2] = points[[0, 0, 0, 1, 2, 2, 2, 2, 0, 0, 3, 3], :2]
    points[5, 3], points[9, :2] = np.nan, np.nan
    outcome, jacobian = evaluate(MAP, points), MAP.jacobian(points[:, :2], points[:, 2:])
    for i, point in enumerate(points):
        alone = evaluate(MAP, point)
        assert outcome.status[i] == alone.status
        assert np.array_equal(outcome.next_state[i], alone.next_state, equal_nan=True)
        assert np.array_equal(jacobian[i], MAP.jacobian(point[:2], point[2:]), equal_nan=True)


def test_lengths_out_of_reach_are_refused() -> None:
    with pytest.raises(ValueError, match="landing_length"):
        ApexMap(gains=Gains(landing_length=0.32))
