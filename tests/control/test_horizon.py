"""Commands of several steps chosen together, against a general solver and closed forms."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from numpy.typing import ArrayLike
from scipy.optimize import least_squares

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.goal import CAUTION, goals_for
from stepgap.control.horizon import plan_ahead
from stepgap.control.settings import ControlSettings
from stepgap.control.step_controller import StepController
from stepgap.step import Array, Codes, StepMap, StepSpace, StepStatus
from tests.control.maps import CountingMap, LossyHopper, StumblingHopper, Track

EXACT = ControlSettings(cautious=False, viability=False, avoid_failures=False, evaluations=10**6)


class Weak(LossyHopper):
    """A hopper whose forces are too small for large changes in one step."""

    @property
    def space(self) -> StepSpace:
        space = super().space
        fx, fy = space.command
        return replace(space, command=(replace(fx, lower=-3.0, upper=3.0), replace(fy, lower=-6.0, upper=6.0)))


@dataclass(frozen=True)
class Doubtful(Weak):
    """The same, with a deviation that grows with the distance from a state and a command that were tried."""

    @property
    def noise_std(self) -> Array:
        return np.full(2, 1e-4)

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        away = self._away(state, command)
        return np.sqrt(1e-8 + np.sum(away**2, axis=-1, keepdims=True)) * np.array([0.05, 0.03])

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:
        away, (scale, size) = self._away(state, command), (np.array([0.4, 0.12, 6.0, 12.0]), np.array([0.05, 0.03]))
        return size[:, None] * (away / scale / np.sqrt(1e-8 + np.sum(away**2, axis=-1, keepdims=True)))[..., None, :]

    @staticmethod
    def _away(state: ArrayLike, command: ArrayLike) -> Array:
        state, command = np.asarray(state, float), np.asarray(command, float)
        lead = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
        point = [np.broadcast_to(each, (*lead, 2)) for each in (state, command)]
        return (np.concatenate(point, axis=-1) - [0.15, 0.57, 0.5, 1.0]) / [0.4, 0.12, 6.0, 12.0]


def cost_of(step_map: StepMap, state: Array, commands: Array, targets: Array) -> float:
    total = 0.0
    for command, target in zip(commands, targets, strict=True):
        std, state = step_map.std(state, command), step_map(state, command)
        wanted = step_map.space.has_target(target)
        squares = (np.nan_to_num(state - target) ** 2 + (CAUTION * std) ** 2) / step_map.space.error_scale**2
        total += float(np.sum(squares[wanted]))
    return total


def best_cost(step_map: StepMap, state: Array, targets: Array, starts: int = 6) -> float:
    """Least cost, by a solver for bounded least squares that knows nothing of steps."""
    space, m, rng = step_map.space, len(step_map.space.command), np.random.default_rng(0)
    wanted = space.has_target(targets)

    def errors(flat: Array) -> Array:
        at, found = state, []
        for command, target in zip(flat.reshape(-1, m), targets, strict=True):
            std, at = step_map.std(at, command), step_map(at, command)
            found.append([(at - target) / space.error_scale, CAUTION * std / space.error_scale])
        return np.swapaxes(found, 0, 1)[:, wanted].reshape(-1)

    lower, upper = np.tile(space.command_lower, len(targets)), np.tile(space.command_upper, len(targets))
    found = [least_squares(errors, rng.uniform(lower, upper), bounds=(lower, upper), xtol=1e-12) for _ in range(starts)]
    return 2 * min(each.cost for each in found)


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize("steps", [2, 3])
@pytest.mark.parametrize("robot", [Weak(), Doubtful()], ids=["certain", "doubtful"])
def test_the_sequence_is_the_best_that_a_general_solver_finds(robot: Weak, seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    space = robot.space
    state = space.state_centre + space.state_scale * rng.uniform(-0.5, 0.5, 2)
    targets = space.state_centre + space.state_scale * rng.uniform(-0.8, 0.8, (steps, 2))
    first = StepController(robot)(state, targets[0])
    plan = plan_ahead(robot, state, goals_for(robot, targets).together, first)

    def total(command: Array, end: Array) -> float:
        """Cost of a first step with the best that can follow it."""
        return cost_of(robot, state, command[None], targets[:1]) + best_cost(robot, end, targets[1:])

    expected, found = best_cost(robot, state, targets), total(plan.command, plan.predicted)
    assert found <= expected * (1 + 2e-3) + 1e-9
    assert found <= total(first.command, first.predicted) * (1 + 1e-6) + 1e-9


def test_steps_that_reach_their_targets_are_planned_as_before() -> None:
    robot = LossyHopper()
    targets = np.array([[0.2, 0.58], [0.25, 0.59], [0.25, 0.59]])
    first = StepController(robot)(np.array([0.15, 0.57]), targets[0])
    assert plan_ahead(robot, np.array([0.15, 0.57]), goals_for(robot, targets).together, first) is first


def test_a_change_that_takes_two_steps_begins_one_step_early() -> None:
    robot = Weak()
    low, high = np.array([0.1, 0.56]), np.array([0.1, 0.60])
    assert not StepController(robot)(low, high).reached
    alone = CautiousController(robot, robot, np.empty((0, 4)), EXACT)(low, low)
    early = CautiousController(robot, robot, np.empty((0, 4)), EXACT)(low, low, ahead=high[None])
    assert alone.predicted[1] == pytest.approx(low[1], abs=1e-6)
    assert low[1] + 1e-3 < early.predicted[1] < high[1]
    missed = [StepController(robot)(plan.predicted, high).distance for plan in (alone, early)]
    assert missed[1] < missed[0]


def test_an_uncertain_sequence_is_not_worse_than_that_of_the_nominal_map() -> None:
    robot, nominal = Doubtful(), Weak(mass=1.5)
    low, high = np.array([0.1, 0.56]), np.array([0.1, 0.62])
    plan = CautiousController(robot, nominal, np.empty((0, 4)))(low, low, ahead=np.stack([high, high]))
    others = [StepController(nominal)(low, low).command, StepController(robot)(low, low).command]
    costs = [
        cost_of(robot, low, command[None], low[None]) + best_cost(robot, robot(low, command), np.stack([high, high]))
        for command in (plan.command, *others)
    ]
    assert costs[0] <= min(costs[1:]) * (1 + 2e-3)
    assert plan.predicted[1] > low[1] + 1e-3, "it begins early, although it is not certain"


def test_a_change_of_lane_takes_fewer_steps_with_a_view_to_more_of_them() -> None:
    """One push for offset and rate: a single step trades them off, and so closes little of the gap."""
    robot, target = Track(), np.array([0.2, 0.0])
    controller = CautiousController(robot, robot, np.empty((0, 3)), EXACT)

    def steps_until_there(ahead: int) -> int:
        state, steps = np.zeros(2), 0
        while np.abs(state - target).max() >= 0.01:
            state, steps = controller(state, target, ahead=np.tile(target, (ahead, 1))).predicted, steps + 1
        return steps

    assert steps_until_there(0) >= 2 * steps_until_there(1) > 2 * steps_until_there(2)


def test_a_sequence_that_would_fail_is_not_begun_and_a_spent_budget_leaves_the_single_step() -> None:
    robot = StumblingHopper()
    state, targets = np.array([0.1, 0.56]), np.array([[0.1, 0.56], [0.4, 0.66], [0.4, 0.66]])
    first = StepController(robot)(state, targets[0])
    plan = plan_ahead(robot, state, goals_for(robot, targets).together, first)
    after = [StepController(robot)(each.predicted, targets[1]).distance + each.distance for each in (plan, first)]
    assert after[0] <= after[1] + 1e-9
    few, counted = replace(EXACT, evaluations=20), CountingMap(Weak())
    found = CautiousController(counted, counted, np.empty((0, 4)), few)(targets[0], targets[0], ahead=targets[1:])
    assert np.isfinite(found.predicted).all()
    assert counted.evaluations + 8 * counted.jacobians <= 3 * few.evaluations


def test_an_unsafe_sequence_leaves_the_command_of_the_single_step() -> None:
    robot, rules = Weak(), replace(EXACT, avoid_failures=True)
    low, high = np.array([0.1, 0.56]), np.array([0.1, 0.60])

    def planned(failures: Array, *ahead: Array) -> Array:
        controller = CautiousController(robot, robot, failures, rules)
        return controller(low, low, ahead=np.array(ahead).reshape(-1, 2)).command

    none = np.empty((0, 4))
    early, alone = planned(none, high), planned(none)
    failure = np.concatenate([low, early])[None]
    scaled = (early - alone) / robot.space.command_scale
    assert np.abs(scaled).max() > 0.2, "the failure is not near the command of the single step"
    assert planned(failure, high).tolist() == alone.tolist()


def test_targets_may_be_missing_ahead() -> None:
    robot = Weak()
    state, targets = np.array([0.1, 0.56]), np.array([[0.1, 0.56], [np.nan, 0.62]])
    first = StepController(robot)(state, targets[0])
    plan = plan_ahead(robot, state, goals_for(robot, targets).together, first)
    assert plan is not first
    assert plan.predicted[0] == pytest.approx(0.1, abs=0.005), "the speed is wanted now, and free in the next step"
    total = cost_of(robot, state, plan.command[None], targets[:1]) + best_cost(robot, plan.predicted, targets[1:])
    assert total <= best_cost(robot, state, targets) * (1 + 2e-3)


def test_where_a_later_step_of_every_sequence_fails_the_first_is_planned_alone() -> None:
    class Once(Doubtful):
        """From no state but the first one there is a step."""

        def status(self, state: Array, command: Array) -> Codes:
            there = np.abs(state - low).max(axis=-1) > 1e-12
            shape = np.broadcast_shapes(state.shape[:-1], command.shape[:-1])
            return np.broadcast_to(np.where(there, StepStatus.FELL, StepStatus.OK), shape)

    low, high = np.array([0.1, 0.56]), np.array([0.1, 0.62])
    rules = replace(EXACT, cautious=True)
    plans = [
        CautiousController(Once(), Once(), np.empty((0, 4)), rules)(low, low, ahead=ahead)
        for ahead in (np.empty((0, 2)), high[None])
    ]
    assert plans[0].command.tolist() == plans[1].command.tolist()
