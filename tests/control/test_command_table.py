"""Tables of commands: equal to the controller at their nodes, and near it between them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stepgap.control.box_points import box_grid
from stepgap.control.command_table import CommandTable, build_table
from stepgap.control.step_controller import StepController
from stepgap.step import Array, StepFailed
from tests.control.maps import FoldedMap, LossyHopper, NeverWorks, RedundantMap, StumblingHopper

POINTS = 4


@pytest.fixture(scope="module")
def table() -> CommandTable:
    return build_table(LossyHopper(), POINTS)


def state_at(fractions: Array) -> Array:
    """State at fractions of the range of use; outside of it beyond 0 and 1."""
    return np.array([0.0, 0.52]) + np.array([0.4, 0.12]) * fractions


def worst_error(table: CommandTable, samples: int) -> Array:
    """Largest difference of the next state to reached targets at random points between the nodes; shape (n,)."""
    rng = np.random.default_rng(1)
    off = np.zeros(2)
    for state, target in state_at(rng.uniform(0, 1, (samples, 2, 2))):
        plan = table(state, target)
        if plan.reached:
            off = np.maximum(off, np.abs(LossyHopper()(state, plan.command) - target))
    return off


anywhere = arrays(float, 2, elements=st.floats(-0.5, 1.5))


def test_at_its_nodes_it_equals_the_controller(table: CommandTable) -> None:
    controller = StepController(LossyHopper())
    for fraction in np.random.default_rng(0).integers(0, POINTS, (60, 4)) / (POINTS - 1):
        state, target = state_at(fraction[:2]), state_at(fraction[2:])
        plan, solved = table(state, target), controller(state, target)
        assert plan.reached == solved.reached
        np.testing.assert_allclose(plan.predicted, solved.predicted, atol=1e-6)
        np.testing.assert_allclose(plan.command, solved.command, atol=1e-3)
        assert plan.distance == pytest.approx(solved.distance, abs=1e-5)


def test_the_error_falls_with_the_spacing(table: CommandTable) -> None:
    coarse = worst_error(table, 200)
    fine = worst_error(build_table(LossyHopper(), POINTS + 2), 200)
    assert (coarse < 0.05 * LossyHopper().space.state_scale).any()
    assert (fine <= coarse / 1.8 + 1e-12).all()


@settings(max_examples=60, deadline=None, derandomize=True)
@given(state=anywhere, target=anywhere)
def test_commands_never_leave_their_bounds(table: CommandTable, state: Array, target: Array) -> None:
    plan = table(state_at(state), state_at(target), guess=[0.0, 0.0])
    assert (np.abs(plan.command) <= [15, 20]).all()
    assert np.isfinite(plan.predicted).all()
    inside = np.array([state, target])
    if (inside < -1e-6).any() or (inside > 1 + 1e-6).any():
        assert not plan.reached
        nearest = table(state_at(np.clip(state, 0, 1)), state_at(np.clip(target, 0, 1)))
        np.testing.assert_allclose(plan.command, nearest.command, atol=1e-9)


def test_any_number_of_coordinates_and_commands() -> None:
    for step_map in (FoldedMap(), RedundantMap()):
        table = build_table(step_map, 4)
        middle = [(quantity.lower + quantity.upper) / 2 for quantity in step_map.space.state]
        assert len(table(middle, middle).command) == len(step_map.space.command)


def test_where_the_map_fails_the_table_fails() -> None:
    table = build_table(NeverWorks(), 2)
    with pytest.raises(StepFailed):
        table([0.2, 0.58], [0.2, 0.58])


def test_nodes_with_unreachable_targets_are_marked() -> None:
    table = build_table(StumblingHopper(), 3)
    assert 0 < table.reached.mean() < 1
    assert np.isfinite(table.commands).all()
    distance = np.linalg.norm(table.predicted[0, 0] - state_at((box_grid(3, 2) + 1) / 2), axis=-1)
    np.testing.assert_array_equal(table.reached[0, 0], distance < 1e-6)


def test_bad_arguments_are_refused(table: CommandTable) -> None:
    with pytest.raises(ValueError, match="points = 1"):
        build_table(LossyHopper(), 1)
    with pytest.raises(ValueError, match="state has shape"):
        table([0.2], [0.2, 0.58])
    with pytest.raises(ValueError, match="finite"):
        table([0.2, 0.58], [0.2, np.nan])
    with pytest.raises(StepFailed):
        table([0.2, np.nan], [0.2, 0.58])
