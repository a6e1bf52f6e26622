"""The cost of this and all later steps, against the Riccati equation, sums along steps, and random draws."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.goal import CAUTION, EFFORT_WEIGHT, UNTRACKED_WEIGHT, Deviation, Targets, goals_for
from stepgap.control.settings import ControlSettings
from stepgap.control.step_controller import StepController
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepSpace
from tests.control.maps import CountingMap, LossyHopper, NeverWorks, PitchingHopper, Track

NONE = np.nan


def random_map(seed: int) -> AffineMap:
    """Five states, of which two are tracked, with ranges that are not centred; two commands; zero repeats itself."""
    rng = np.random.default_rng(seed)
    weights, sizes = (1.0, 4.0, 0.0, 0.0, 0.0), rng.uniform(0.2, 2.0, 7)
    state = tuple(Quantity(f"x{k}", "", -0.7 * sizes[k], sizes[k], weight) for k, weight in enumerate(weights))
    command = tuple(Quantity(f"u{k}", "", -sizes[5 + k], sizes[5 + k]) for k in range(2))
    matrix = rng.normal(size=(5, 7)) * 0.5
    return AffineMap(StepSpace(state, command), np.zeros(5), np.zeros(2), np.zeros(5), matrix)


def stage_costs(step_map: AffineMap) -> tuple[Array, Array]:
    """Weights of squared states and of squared commands; shapes (5, 5) and (2, 2)."""
    space = step_map.space
    weights = np.array([1.0, 4.0, *3 * [UNTRACKED_WEIGHT]]) / space.state_scale**2
    return np.diag(weights), EFFORT_WEIGHT * np.diag(1 / space.command_scale**2)


@pytest.mark.parametrize("seed", range(6))
def test_the_form_solves_the_riccati_equation_and_is_the_sum_of_the_costs_of_later_steps(seed: int) -> None:
    step_map = random_map(seed)
    by_state, by_command = np.split(step_map.matrix, [5], axis=1)
    states, commands = stage_costs(step_map)
    form = solve_discrete_are(by_state, by_command, states, commands)
    (goal,) = goals_for(step_map, np.array([[0.0, 0.0, NONE, NONE, NONE]])).together
    assert isinstance(goal, Deviation)
    np.testing.assert_allclose(goal.state, 0, atol=1e-6)
    np.testing.assert_allclose(goal.root.T @ goal.root, form, rtol=1e-4, atol=1e-6 * np.abs(form).max())
    state = start = np.random.default_rng(seed + 100).normal(size=5) * 0.1
    gain, total = np.linalg.solve(commands + by_command.T @ form @ by_command, by_command.T @ form @ by_state), 0.0
    for _ in range(400):
        command = -gain @ state
        total += state @ states @ state + command @ commands @ command
        state = by_state @ state + by_command @ command
    assert np.sum(goal.errors(start) ** 2) == pytest.approx(total, rel=1e-4)


def test_earlier_steps_count_with_their_own_errors() -> None:
    step_map, target = random_map(0), np.array([0.0, 0.0, NONE, NONE, NONE])
    first, second, last = goals_for(step_map, np.tile(target, (3, 1))).together
    at = np.random.default_rng(1).normal(size=(7, 5))
    for goal in (first, second):
        np.testing.assert_allclose(
            np.sum(goal.errors(at) ** 2, axis=-1), np.einsum("ki,ij,kj->k", at, stage_costs(step_map)[0], at), rtol=1e-6
        )
    assert (np.sum(last.errors(at) ** 2, axis=-1) > np.sum(first.errors(at) ** 2, axis=-1)).all()


@pytest.mark.parametrize("tracked", [True, False])
def test_derivatives_and_spread_belong_to_the_errors(tracked: bool) -> None:
    rng, space = np.random.default_rng(2), random_map(3).space
    target = np.array([0.1, NONE, 0.2, NONE, NONE])
    goal = Targets(space, target) if tracked else goals_for(random_map(3), target[None]).onward[0]
    at, matrix, std = rng.normal(size=5), rng.normal(size=(5, 3)), rng.uniform(0.1, 1.0, 5)
    columns = [goal.errors(at + column) - goal.errors(at) for column in matrix.T]
    np.testing.assert_allclose(goal.errors_by(matrix), np.transpose(columns), atol=1e-12)
    drawn = np.sum(goal.errors(at + std * rng.normal(size=(400_000, 5))) ** 2, axis=-1)
    expected = np.sum(goal.errors(at) ** 2) + np.sum((goal.spread(std) / CAUTION) ** 2)
    assert drawn.mean() == pytest.approx(expected, abs=5 * drawn.std() / np.sqrt(len(drawn)))
    np.testing.assert_allclose(goal.spread(np.stack([std, 2 * std], axis=1))[:, 1], 2 * goal.spread(std))


def test_targets_remain_where_all_is_tracked_or_nothing_is_known() -> None:
    (goal,) = goals_for(LossyHopper(), np.array([[0.1, 0.56]])).together
    assert isinstance(goal, Targets)

    class Lost(NeverWorks):
        @property
        def space(self) -> StepSpace:
            first, second = super().space.state
            return replace(super().space, state=(first, replace(second, weight=0)))

    (goal,) = goals_for(Lost(), np.array([[0.1, NONE]])).onward
    assert isinstance(goal, Targets)


class Drifting(Track):
    """The same, without targets of the rate."""

    @property
    def space(self) -> StepSpace:
        offset, rate = super().space.state
        return replace(super().space, state=(offset, replace(rate, weight=0)))


@pytest.mark.parametrize("ahead", [0, 1, 2])
def test_a_place_that_is_reached_at_once_is_not_left_again(ahead: int) -> None:
    """A push moves the place less than the rate, so steps that are only to be at the place overshoot."""
    robot, target = Drifting(), np.array([0.2, NONE])
    controller = CautiousController(robot, robot, np.empty((0, 3)))
    state, alone, offsets = np.zeros(2), np.zeros(2), list[Array]()
    for _ in range(12):
        state = controller(state, target, ahead=np.tile(target, (ahead, 1))).predicted
        alone = StepController(robot)(alone, target).predicted
        offsets.append(np.array([state[0], alone[0]]))
    regulated, greedy = np.max(offsets, axis=0)
    assert regulated < 0.22 < 0.28 < greedy
    np.testing.assert_allclose(state, [0.2, 0.0], atol=2e-3)


def test_a_state_that_no_command_moves_changes_nothing() -> None:
    """Such as a heading: no command stabilises it, and it has a cost-to-go all the same."""

    class Heading(Drifting):
        @property
        def space(self) -> StepSpace:
            return replace(super().space, state=(*super().space.state, Quantity("heading", "rad", -1, 1, weight=0)))

        def next_state(self, state: Array, command: Array) -> Array:
            track = super().next_state(state[..., :2], command)
            return np.concatenate([track, np.broadcast_to(state[..., 2:], (*track.shape[:-1], 1))], axis=-1)

    targets = np.array([0.2, NONE, NONE])
    plans = [
        CautiousController(robot, robot, np.empty((0, n + 1)))(np.array([0.1, 0.1, 0.3])[:n], targets[:n])
        for robot, n in ((Heading(), 3), (Drifting(), 2))
    ]
    np.testing.assert_allclose(plans[0].command, plans[1].command, atol=1e-6)


def test_a_disturbed_pitch_is_damped_by_what_moves_it() -> None:
    robot = PitchingHopper()
    controller, target = CautiousController(robot, robot, np.empty((0, 6))), np.array([0.2, 0.58, NONE, NONE])
    state = np.array([0.2, 0.58, 0.3, -1.0])
    for _ in range(15):
        state = controller(state, target).predicted
    np.testing.assert_allclose(state[:2], target[:2], atol=1e-3)


def test_few_evaluations_suffice_for_a_command_and_goals_are_found_once_for_each_target() -> None:
    counted = CountingMap(Drifting())
    controller = CautiousController(counted, counted, np.empty((0, 3)), ControlSettings(evaluations=100))
    state, target = np.array([0.05, 0.1]), np.array([0.2, NONE])
    few = controller(state, target).command
    many = CautiousController(Drifting(), Drifting(), np.empty((0, 3)))(state, target).command
    np.testing.assert_allclose(few, many, atol=1e-6)
    begin = counted.jacobians
    goals_for(counted, target[None])
    alone = counted.jacobians - begin
    goals_for(counted, np.tile(target, (4, 1)))
    assert counted.jacobians - begin == 2 * alone
