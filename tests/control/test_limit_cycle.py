from dataclasses import replace

import numpy as np
import pytest

from stepgap.control.limit_cycle import fixed_point, floquet_multipliers, reachable_set
from stepgap.step import Array, Codes, Quantity, StepFailed, StepSpace, StepStatus
from tests.control.maps import FX, ClosedFormMap, LossyHopper, NeverWorks, RedundantMap, ScalarMap, StumblingHopper


class Spiral(ClosedFormMap):
    """Turns the state by 1 rad and stretches it by a factor; the command shifts it along the first axis."""

    def __init__(self, stretch: float):
        self.matrix = stretch * np.array([[np.cos(1), -np.sin(1)], [np.sin(1), np.cos(1)]])

    @property
    def space(self) -> StepSpace:
        return StepSpace((Quantity("a", "m", -1, 1), Quantity("b", "m", -1, 1)), (FX,))

    def next_state(self, state: Array, command: Array) -> Array:
        return state @ self.matrix.T + command * [0.1, 0.0]


def test_fixed_point_holds_the_target_with_the_closed_form_command():
    step_map = LossyHopper()
    target = np.array([0.2, 0.58])
    cycle = fixed_point(step_map, target)
    assert cycle.held
    np.testing.assert_allclose(cycle.command, step_map.command_for(target, target), atol=1e-6)
    np.testing.assert_allclose(step_map(cycle.state, cycle.command), target, atol=1e-9)


def test_multipliers_are_those_of_the_closed_form():
    step_map = LossyHopper()
    cycle = fixed_point(step_map, [0.2, 0.58])
    np.testing.assert_allclose(cycle.floquet_multipliers, [step_map.keep, 1 - step_map.loss], atol=1e-8)
    assert cycle.stable


@pytest.mark.parametrize(("stretch", "stable"), [(0.9, True), (1.1, False)])
def test_complex_multipliers_decide_stability(stretch, stable):
    spiral = Spiral(stretch)
    cycle = fixed_point(spiral, np.linalg.solve(np.eye(2) - spiral.matrix, [0.05, 0.0]))
    np.testing.assert_allclose(cycle.command, [0.5], atol=1e-8)
    assert cycle.held
    assert cycle.stable is stable
    np.testing.assert_allclose(sorted(cycle.floquet_multipliers, key=np.imag), stretch * np.exp([-1j, 1j]), atol=1e-8)


def test_unstable_fixed_point_is_held_all_the_same():
    step_map = LossyHopper(keep=1.2, drift=-0.04)
    cycle = fixed_point(step_map, [0.2, 0.58])
    assert cycle.held
    assert not cycle.stable
    assert cycle.floquet_multipliers[0] == pytest.approx(1.2)


def test_state_that_cannot_be_held_has_the_closest_next_state():
    step_map = LossyHopper(loss=0.9)
    cycle = fixed_point(step_map, [0.2, 0.64])
    assert not cycle.held
    assert not cycle.stable
    assert cycle.command[1] == pytest.approx(20)
    assert cycle.next_state[1] < 0.64
    gap = (cycle.next_state - [0.2, 0.64]) / step_map.space.state_scale
    assert cycle.distance == pytest.approx(np.linalg.norm(gap))


def test_more_commands_than_states_hold_too():
    cycle = fixed_point(RedundantMap(), [0.2, 0.58])
    assert cycle.held
    np.testing.assert_allclose(cycle.floquet_multipliers, [0.6, 0.6], atol=1e-8)


def test_without_a_working_command_the_step_fails():
    with pytest.raises(StepFailed):
        fixed_point(NeverWorks(), [0.2, 0.58])


def test_multipliers_next_to_failing_steps_are_nan():
    class OnEdge(LossyHopper):
        def status(self, state: Array, command: Array) -> Codes:
            return np.where(state[..., 0] > 0.2, StepStatus.FELL, super().status(state, command))

    assert np.isnan(floquet_multipliers(OnEdge(), [0.2, 0.58], [0, 0])).all()


def test_reachable_set_contains_the_grid_and_marks_failures():
    step_map, state = StumblingHopper(), np.array([0.2, 0.58])
    reachable = reachable_set(step_map, state, samples=9)
    assert reachable.commands.shape == reachable.next_states.shape == (9, 9, 2)
    assert (reachable.commands >= step_map.space.command_lower).all()
    assert (reachable.commands <= step_map.space.command_upper).all()
    failed = reachable.statuses != StepStatus.OK
    assert failed.any()
    assert not failed.all()
    assert np.array_equal(np.isnan(reachable.next_states).all(axis=-1), failed)
    assert reachable.statuses[-1, -1] == StepStatus.FELL
    assert reachable.statuses[0, 0] == StepStatus.NO_TAKE_OFF


def test_boundary_goes_around_the_command_bounds_once():
    step_map, state = LossyHopper(), np.array([0.2, 0.58])
    reachable = reachable_set(step_map, state, samples=6)
    walk = replace(reachable, next_states=reachable.commands).boundary
    assert walk.shape == (20, 2)
    assert len(np.unique(walk, axis=0)) == 20
    closed = np.vstack([walk, walk[:1]])
    assert ((closed[1:] != closed[:-1]).sum(axis=1) == 1).all()
    area = 0.5 * np.sum(closed[:-1, 0] * closed[1:, 1] - closed[1:, 0] * closed[:-1, 1])
    assert area == pytest.approx(30 * 40)
    np.testing.assert_array_equal(reachable.boundary, step_map(state, walk))


def test_boundary_encloses_the_reachable_set_of_a_map_without_folds():
    step_map, state = LossyHopper(), np.array([0.2, 0.58])
    reachable = reachable_set(step_map, state, samples=11)
    polygon, inside = reachable.boundary, reachable.next_states[1:-1, 1:-1].reshape(-1, 2)
    edge = np.roll(polygon, -1, axis=0) - polygon
    offset = inside[:, None] - polygon
    assert (edge[:, 0] * offset[..., 1] - edge[:, 1] * offset[..., 0] > 0).all()


def test_other_than_two_commands_have_no_polygon():
    reachable = reachable_set(ScalarMap(), [0.2, 0.58], samples=5)
    assert reachable.next_states.shape == (5, 2)
    with pytest.raises(ValueError, match="polygon for two commands, not for 1"):
        _ = reachable.boundary
    assert reachable_set(RedundantMap(), [0.2, 0.58], samples=3).next_states.shape == (9, 2)


def test_a_grid_of_one_sample_is_refused():
    with pytest.raises(ValueError, match="at least 2"):
        reachable_set(LossyHopper(), [0.2, 0.58], samples=1)
