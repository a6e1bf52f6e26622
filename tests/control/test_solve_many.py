import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import lsq_linear

from stepgap.control.box_points import box_grid
from stepgap.control.gauss_newton import box_step, box_steps
from stepgap.control.solve_many import solve_many
from stepgap.control.step_controller import StepController
from stepgap.step import Array, StepMap, StepStatus
from tests.control.maps import (
    CountingMap,
    FoldedMap,
    LossyHopper,
    NeverWorks,
    RedundantMap,
    RoughMap,
    ScalarMap,
    StumblingHopper,
)

MAPS = [LossyHopper(), StumblingHopper(), RedundantMap(), FoldedMap(), RoughMap()]
every_map = pytest.mark.parametrize("step_map", MAPS, ids=lambda step_map: type(step_map).__name__)


def grid(step_map: StepMap, points: int) -> Array:
    """States over the range of use; shape (points ** n, n)."""
    space = step_map.space
    lower = np.array([quantity.lower for quantity in space.state])
    return (lower + space.state_scale * (1 + box_grid(points, len(lower)))).reshape(-1, len(lower))


@every_map
def test_it_gets_as_close_as_the_controller(step_map):
    states = grid(step_map, 3)
    answers = solve_many(step_map, states, states)
    controller = StepController(step_map)
    for i, state in enumerate(states):
        for j, target in enumerate(states):
            plan = controller(state, target)
            off = (answers.predicted[i, j] - target) / step_map.space.state_scale
            assert answers.reached[i, j] == plan.reached
            assert np.linalg.norm(off) <= plan.distance + 1e-4


@every_map
def test_predictions_are_the_maps_and_commands_within_bounds(step_map):
    states = grid(step_map, 4)
    answers = solve_many(step_map, states, states)
    np.testing.assert_allclose(step_map(states[:, None], answers.command), answers.predicted, rtol=0, atol=1e-12)
    assert (answers.command >= step_map.space.command_lower).all()
    assert (answers.command <= step_map.space.command_upper).all()
    assert (answers.status == StepStatus.OK).all()


def test_it_finds_the_inverse_in_closed_form():
    step_map, rng = LossyHopper(), np.random.default_rng(0)
    states = rng.uniform([0, 0.52], [0.4, 0.64], (50, 2))
    commands = rng.uniform([-15, -20], [15, 20], (50, 8, 2))
    answers = solve_many(step_map, states, step_map(states[:, None], commands))
    assert answers.reached.all()
    np.testing.assert_allclose(answers.command, commands, atol=1e-3)


def test_unreached_targets_get_the_least_distance_of_a_dense_grid():
    step_map = StumblingHopper()
    state, target = np.array([0.1, 0.55]), np.array([0.4, 0.64])
    answers = solve_many(step_map, state[None], target[None])
    dense = step_map.space.command_at(box_grid(201, 2))
    off = (step_map.evaluate(state, dense).next_state - target) / step_map.space.state_scale
    found = np.linalg.norm((answers.predicted[0, 0] - target) / step_map.space.state_scale)
    assert not answers.reached
    assert found <= np.nanmin(np.linalg.norm(off, axis=-1)) + 1e-3


def test_one_command_for_two_coordinates():
    step_map = ScalarMap()
    state = np.array([0.2, 0.58])
    target = step_map(state, [7.0])
    answers = solve_many(step_map, state[None], target[None])
    assert answers.reached
    assert answers.command[0, 0] == pytest.approx([7.0], abs=1e-3)


def test_a_state_without_any_step_has_a_status():
    answers = solve_many(NeverWorks(), grid(NeverWorks(), 2), grid(NeverWorks(), 3))
    assert (answers.status == StepStatus.FELL).all()
    assert np.isnan(answers.command).all()
    assert np.isnan(answers.predicted).all()
    assert not answers.reached.any()


def test_a_node_costs_few_evaluations():
    counting = CountingMap(LossyHopper())
    states = grid(counting, 7)
    solve_many(counting, states, states)
    assert counting.evaluations <= 5 * len(states) ** 2
    assert counting.jacobians <= 3, "a Jacobian is evaluated once for all nodes that start at the same sample"


@pytest.mark.parametrize(
    ("states", "targets", "message"),
    [
        ([0.2, 0.58], [[0.2, 0.58]], "must be"),
        ([[0.2, 0.58]], [[0.2]], "must be"),
        ([[0.2, np.nan]], [[0.2, 0.58]], "finite"),
        ([[0.2, 0.58]], [[0.2, np.inf]], "finite"),
    ],
)
def test_arguments_that_do_not_fit_the_map_are_refused(states, targets, message):
    with pytest.raises(ValueError, match=message):
        solve_many(LossyHopper(), states, targets)


@pytest.mark.parametrize("commands", [2, 5, 12])
def test_steps_within_a_box_are_those_of_scipy(commands: int) -> None:
    rng = np.random.default_rng(commands)
    matrices, values = rng.standard_normal((40, commands, commands)), rng.standard_normal((40, commands))
    lower, upper = -rng.uniform(0, 0.5, (40, commands)), rng.uniform(0, 0.5, (40, commands))
    steps = box_steps(matrices, values, lower, upper, np.zeros(40))
    assert ((steps >= lower) & (steps <= upper)).all()
    for i, step in enumerate(steps):
        found = lsq_linear(matrices[i], -values[i], (lower[i] - 1e-12, upper[i] + 1e-12), method="bvls", tol=1e-14)
        assert np.sum((matrices[i] @ step + values[i]) ** 2) <= 2 * found.cost + 1e-9


entries = st.floats(-3, 3)


@settings(max_examples=60, deadline=None, derandomize=True)
@given(
    matrix=st.integers(1, 3).flatmap(lambda k: arrays(float, (2, k), elements=entries)),
    value=arrays(float, 2, elements=entries),
    low=st.floats(0.01, 2),
    high=st.floats(0.01, 2),
    damping=st.sampled_from([0.0, 0.01, 1.0]),
)
def test_steps_are_no_worse_than_those_of_the_controller(matrix, value, low, high, damping):
    k = matrix.shape[1]
    lower, upper = np.full(k, -low), np.full(k, high)
    step = box_steps(matrix[None], value[None], lower[None], upper[None], np.array([damping]))[0]
    single = box_step(matrix, value, lower, upper, damping)
    assert (step >= lower).all()
    assert (step <= upper).all()
    cost, least = (np.sum((matrix @ p + value) ** 2) + damping * (p @ p) for p in (step, single))
    assert cost <= least + 1e-6 * (1 + value @ value)
