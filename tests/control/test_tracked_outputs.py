"""States that are predicted but not tracked, steps without a target, and weights, against closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.limit_cycle import fixed_point, reached_in_one_step
from stepgap.control.reach import whole_states
from stepgap.control.step_controller import StepController
from stepgap.step import Array, Quantity, StepSpace
from tests.control.maps import LossyHopper, PitchingHopper, ScalarMap

ROBOT = PitchingHopper()
NONE = np.nan


def states(count: int, seed: int = 1) -> Array:
    rng, space = np.random.default_rng(seed), ROBOT.space
    return space.state_centre + 0.5 * space.state_scale * rng.uniform(-1, 1, (count, 4))


def command_for(state: Array, target: Array) -> Array:
    """That of the hopper without pitch, for a target from which the part of the pitch is taken."""
    return LossyHopper().command_for(state[:2], target[:2] - np.array([ROBOT.lean * state[2], 0.0]))


def test_what_is_not_tracked_is_left_as_it_comes() -> None:
    for state in states(20):
        target = np.array([0.2, 0.57, NONE, NONE])
        plan = StepController(ROBOT)(state, target)
        np.testing.assert_allclose(plan.command, command_for(state, target), rtol=1e-5, atol=1e-5)
        assert plan.reached
        np.testing.assert_allclose(plan.predicted, ROBOT(state, plan.command), rtol=0, atol=1e-12)
        ignored = StepController(ROBOT)(state, np.array([0.2, 0.57, 0.3, -1.0]))
        assert ignored.command.tolist() == plan.command.tolist(), "a weight of 0 outweighs a target"


def test_with_fewer_targets_than_commands_the_nearest_command_is_chosen() -> None:
    state = np.array([0.1, 0.56, 0.02, 0.1])
    height_only = np.array([NONE, 0.59, NONE, NONE])
    start = np.array([4.0, 1.0])
    plan = StepController(ROBOT)(state, height_only, start)
    assert plan.reached
    assert plan.command[0] == pytest.approx(start[0], abs=1e-9), "fx has no effect on the height"
    nothing = StepController(ROBOT)(state, np.full(4, NONE), start)
    np.testing.assert_allclose(nothing.command, start)
    assert nothing.reached


@pytest.mark.parametrize("target", [np.array([np.inf, 0.55, NONE, NONE]), np.array([0.1, -np.inf, 0.0, 0.0])])
def test_an_infinite_target_is_refused(target: Array) -> None:
    with pytest.raises(ValueError, match="must be finite numbers, or NaN for no target"):
        StepController(ROBOT)(states(1)[0], target)


@dataclass(frozen=True)
class Weighted(ScalarMap):
    """One command for two coordinates, of which the first counts more."""

    weight: float = 1.0

    @property
    def space(self) -> StepSpace:
        first, second = super().space.state
        return StepSpace((replace(first, weight=self.weight), second), super().space.command)


@pytest.mark.parametrize("weight", [0.0, 0.04, 1.0, 25.0])
def test_weights_decide_where_not_all_can_be_reached(weight: float) -> None:
    robot = Weighted(weight=weight)
    space, state, target = robot.space, robot.space.state_centre, np.array([0.35, 0.5])
    (bounds,) = zip(space.command_lower, space.command_upper, strict=True)

    def cost(command: float) -> float:
        error = (robot.next_state(state, np.array([command])) - target) / space.state_scale
        return float(np.array([weight, 1.0]) @ error**2)

    best = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-9})
    plan = StepController(robot)(state, target)
    assert cost(plan.command[0]) <= best.fun + 1e-9
    np.testing.assert_allclose(plan.distance, np.sqrt(best.fun), rtol=1e-5, atol=1e-7)
    cautious = CautiousController(robot, robot, np.empty((0, 3)))(state, target)
    np.testing.assert_allclose(cautious.command, plan.command, atol=1e-4)


def test_a_target_is_completed_to_a_state_that_a_command_repeats() -> None:
    """Pitch and rate follow from two linear equations at the command that holds speed and height."""
    targets = np.column_stack([np.linspace(0.05, 0.3, 7), np.linspace(0.54, 0.61, 7), np.full((7, 2), NONE)])
    whole = whole_states(ROBOT, targets)
    assert reached_in_one_step(ROBOT, whole, targets).all()
    for state, target in zip(whole, targets, strict=True):
        speed, pitch, rate = state[0], state[2], state[3]
        assert state[:2].tolist() == target[:2].tolist()
        point = fixed_point(ROBOT, target)
        assert point.held
        assert point.state.tolist() == state.tolist()
        push = point.command[0]
        expected = np.linalg.solve([[0.5, -0.08], [0.6, 0.7]], [0.2 * speed, 0.02 * push])
        np.testing.assert_allclose([pitch, rate], expected, atol=1e-5)
    full = np.array([[0.1, 0.55, 0.0, 0.0]])
    tracked = LossyHopper()
    assert whole_states(tracked, full[:, :2]).tolist() == full[:, :2].tolist()


def test_a_space_tracks_something_with_weights_that_are_numbers() -> None:
    with pytest.raises(ValueError, match="weight above 0 of at least one coordinate"):
        StepSpace((Quantity("pitch", "rad", -1, 1, weight=0),), ())
    for weight in (-1.0, np.inf, np.nan):
        with pytest.raises(ValueError, match="weight"):
            Quantity("pitch", "rad", -1, 1, weight=weight)
