import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.optimize import lsq_linear

from stepgap.control.box_points import box_grid
from stepgap.control.gauss_newton import REACHED, box_step
from stepgap.control.step_controller import StepController
from stepgap.step import Array, StepFailed, StepMap, StepStatus
from tests.control.maps import (
    CountingMap,
    FoldedMap,
    LossyHopper,
    NeverWorks,
    RedundantMap,
    RoughMap,
    ScalarMap,
    StumblingHopper,
    WavyMap,
)

MAPS = [LossyHopper(), StumblingHopper(), RedundantMap(), ScalarMap(), FoldedMap(), RoughMap()]
quick = settings(max_examples=30, deadline=None, derandomize=True)
fraction = st.floats(0, 1)
every_map = pytest.mark.parametrize("step_map", MAPS, ids=lambda step_map: type(step_map).__name__)


def states(step_map: StepMap, fractions: Array) -> Array:
    """The state at fractions of the range of use."""
    lower = np.array([quantity.lower for quantity in step_map.space.state])
    return lower + 2 * step_map.space.state_scale * fractions[: len(lower)]


def commands(step_map: StepMap, fractions: Array) -> Array:
    """The command at fractions of the bounds."""
    lower, scale = step_map.space.command_lower, step_map.space.command_scale
    return np.clip(lower + 2 * scale * fractions[: len(lower)], lower, step_map.space.command_upper)


def closest_on_grid(step_map: StepMap, state: Array, target: Array) -> float:
    """Least distance over a dense grid of the command bounds."""
    space = step_map.space
    m = len(space.command)
    grid = space.command_at(box_grid({1: 4001, 2: 201, 3: 41}[m], m))
    next_states = step_map.evaluate(state, grid).next_state
    return float(np.nanmin(np.linalg.norm((next_states - target) / space.state_scale, axis=-1)))


fractions = arrays(float, 3, elements=fraction)


@every_map
@quick
@given(begin=fractions, chosen=fractions, guessed=fractions)
def test_reaches_every_target_made_by_a_command_within_bounds(step_map, begin, chosen, guessed):
    state, command = states(step_map, begin), commands(step_map, chosen)
    target, status = step_map.evaluate(state, command)
    if status != StepStatus.OK:
        return
    plan = StepController(step_map)(state, target, commands(step_map, guessed))
    assert plan.reached
    assert plan.distance <= REACHED
    np.testing.assert_allclose(step_map(state, plan.command), target, atol=1e-6 * step_map.space.state_scale.max())


@every_map
@quick
@given(begin=fractions, end=arrays(float, 3, elements=st.floats(-0.5, 1.5)))
def test_comes_as_close_as_a_dense_grid(step_map, begin, end):
    state, target = states(step_map, begin), states(step_map, end)
    plan = StepController(step_map)(state, target)
    assert plan.distance <= closest_on_grid(step_map, state, target) + 1e-3
    assert plan.reached == (plan.distance <= REACHED)
    assert (step_map.space.command_lower <= plan.command).all()
    assert (plan.command <= step_map.space.command_upper).all()
    assert np.array_equal(plan.predicted, step_map(state, plan.command))
    distance = np.linalg.norm((plan.predicted - target) / step_map.space.state_scale)
    assert plan.distance == pytest.approx(distance, abs=1e-15)


@quick
@given(begin=fractions, chosen=fractions)
def test_finds_the_closed_form_inverse(begin, chosen):
    step_map = LossyHopper()
    state = states(step_map, begin)
    target = step_map(state, commands(step_map, chosen))
    expected = step_map.command_for(state, target)
    plan = StepController(step_map)(state, target)
    np.testing.assert_allclose(plan.command, expected, atol=1e-5)
    assert plan.distance <= 1e-9


def test_the_solution_for_an_unreachable_target_satisfies_the_conditions_of_an_optimum():
    step_map, generator = LossyHopper(), np.random.default_rng(3)
    unreached = 0
    for _ in range(100):
        state = states(step_map, generator.uniform(size=2))
        target = states(step_map, generator.uniform(-0.5, 1.5, size=2))
        plan = StepController(step_map)(state, target)
        space = step_map.space
        jacobian = step_map.jacobian(state, plan.command)[:, 2:] * space.command_scale / space.state_scale[:, None]
        downhill = -jacobian.T @ ((plan.predicted - target) / space.state_scale)
        at_lower, at_upper = plan.command <= space.command_lower, plan.command >= space.command_upper
        assert (np.abs(downhill[~at_lower & ~at_upper]) < 1e-4).all()
        assert (downhill[at_lower] < 1e-4).all()
        assert (downhill[at_upper] > -1e-4).all()
        unreached += not plan.reached
    assert unreached > 20


def test_reports_the_distance_to_an_unreachable_target():
    step_map = LossyHopper()
    state = np.array([0.1, 0.56])
    target = np.add(step_map(state, [15, 5]), [0.1, 0])
    plan = StepController(step_map)(state, target)
    assert not plan.reached
    np.testing.assert_allclose(plan.command, [15, 5], atol=1e-3)
    assert plan.distance == pytest.approx(0.1 / 0.2)


def test_a_wrong_local_minimum_is_left():
    plan = StepController(FoldedMap())([1.0], [0.0], guess=[0.0])
    assert plan.distance == pytest.approx(closest_on_grid(FoldedMap(), np.array([1.0]), np.array([0.0])), abs=1e-5)
    assert plan.command[0] > 0.9


def test_for_unreachable_targets_the_cost_is_bounded():
    counted = CountingMap(LossyHopper())
    plan = StepController(counted)([0.2, 0.58], [2.0, 0.58])
    assert not plan.reached
    assert counted.cost <= 150


def test_a_guess_that_fails_is_replaced():
    step_map = StumblingHopper()
    state, command = np.array([0.2, 0.58]), np.array([-5.0, -6.0])
    plan = StepController(step_map)(state, step_map(state, command), guess=[15, 20])
    assert plan.reached
    np.testing.assert_allclose(plan.command, command, atol=1e-4)


def test_stops_at_the_border_of_failing_steps():
    step_map = StumblingHopper()
    state, target = np.array([0.2, 0.58]), np.array([0.45, 0.75])
    plan = StepController(step_map)(state, target)
    assert not plan.reached
    assert plan.command[0] / 15 + plan.command[1] / 20 == pytest.approx(step_map.fall_line, abs=1e-3)
    assert plan.distance <= closest_on_grid(step_map, state, target) + 1e-3


def test_finds_the_few_commands_that_work():
    step_map = StumblingHopper(fall_line=-1.45)
    plan = StepController(step_map)([0.2, 0.58], [0.2, 0.58])
    assert np.isfinite(plan.predicted).all()


def test_no_working_command_is_a_failed_step():
    with pytest.raises(StepFailed) as failure:
        StepController(NeverWorks())([0.2, 0.58], [0.2, 0.58])
    assert failure.value.status is StepStatus.FELL


def test_state_that_is_not_finite_is_a_failed_step():
    with pytest.raises(StepFailed) as failure:
        StepController(LossyHopper())([np.nan, 0.58], [0.2, 0.58])
    assert failure.value.status is StepStatus.INVALID


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (([0.2], [0.2, 0.58]), r"state has shape \(1,\); it must be \(2,\)"),
        (([0.2, 0.58], [[0.2, 0.58]]), r"target has shape \(1, 2\)"),
        (([0.2, 0.58], [0.2, 0.58], [0.0]), "guess has shape"),
        (([0.2, 0.58], [0.2, np.inf]), "must be finite"),
        (([0.2, 0.58], [0.2, 0.58], [0, np.nan]), "must be finite"),
    ],
)
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        StepController(LossyHopper())(*arguments)


def test_redundant_commands_stay_near_the_guess():
    step_map = RedundantMap()
    state, guess = np.array([0.2, 0.58]), np.array([3.0, -4.0, 0.1])
    plan = StepController(step_map)(state, np.add(step_map(state, guess), [0.01, 0.002]), guess)
    assert plan.reached
    assert (np.abs(plan.command - guess) / step_map.space.command_scale < 0.1).all()


@pytest.mark.parametrize(
    "inner", [LossyHopper(), StumblingHopper(), RoughMap(grain=1e-7)], ids=["plain", "bent", "rough"]
)
def test_an_ordinary_solve_costs_few_evaluations(inner):
    generator, costs = np.random.default_rng(1), []
    while len(costs) < 100:
        state = states(inner, generator.uniform(size=2))
        target, status = inner.evaluate(state, commands(inner, generator.uniform(0.1, 0.9, size=2)))
        if status == StepStatus.OK:
            counted = CountingMap(inner)
            StepController(counted)(state, target)
            costs.append(counted.cost)
    assert np.median(costs) <= 20
    assert np.percentile(costs, 90) <= 30


@quick
@given(
    matrix=arrays(float, (3, 3), elements=st.floats(-1, 1).map(lambda x: round(x, 3))),
    value=arrays(float, 3, elements=st.floats(-3, 3)),
    room=arrays(float, (2, 3), elements=st.sampled_from([0.0, 0.1, 1.0])),
    damping=st.sampled_from([0.01, 1.0]),
)
def test_box_step_is_the_bounded_least_squares_of_scipy(matrix, value, room, damping):
    lower, upper = -room[0], room[1] + 1e-3
    step = box_step(matrix, value, lower, upper, damping)
    stacked = np.vstack([matrix, np.sqrt(damping) * np.eye(3)])
    oracle = lsq_linear(stacked, -np.append(value, np.zeros(3)), (lower, upper), method="bvls", tol=1e-12)
    np.testing.assert_allclose(step, oracle.x, atol=1e-6)


@pytest.mark.parametrize(("n", "m"), [(2, 2), (4, 8), (8, 8), (12, 12), (30, 12)])
def test_evaluations_grow_at_most_with_the_number_of_inputs(n: int, m: int) -> None:
    """A grid of only three commands along each of twelve axes would have half a million points."""
    step_map, rng = CountingMap(WavyMap(n, m)), np.random.default_rng(0)
    space = step_map.space
    for _ in range(10):
        state, target = rng.uniform(-1, 1, (2, n))
        step_map.evaluations = step_map.jacobians = 0
        plan = StepController(step_map)(state, target)
        assert step_map.cost < 2000 + 200 * (n + m)
        assert np.abs(space.point_of(plan.command)).max() <= 1
        command = space.command_at(rng.uniform(-0.5, 0.5, m))
        reachable = StepController(step_map)(state, step_map(state, command))
        assert reachable.distance < 0.1
