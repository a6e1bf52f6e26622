"""One notion of a target that is reached, and the rank and the delay of the commands' effect."""

from dataclasses import dataclass

import numpy as np
import pytest

from stepgap.control.limit_cycle import fixed_point, reached_in_one_step
from stepgap.control.reach import command_effect, within_noise
from stepgap.step import Array, Quantity, StepSpace
from tests.control.maps import ClosedFormMap, LossyHopper


@dataclass(frozen=True)
class Linear(ClosedFormMap):
    """x⁺ = A x + B u, with a noise."""

    by_state: tuple[tuple[float, ...], ...]
    by_command: tuple[tuple[float, ...], ...]
    noise: float = 0.0

    @property
    def space(self) -> StepSpace:
        n, m = np.shape(self.by_command)
        return StepSpace(
            tuple(Quantity(f"x{row}", "m", -1, 1) for row in range(n)),
            tuple(Quantity(f"u{row}", "N", -1, 1) for row in range(m)),
        )

    @property
    def noise_std(self) -> Array:
        return np.full(len(self.space.state), self.noise)

    def next_state(self, state: Array, command: Array) -> Array:
        return state @ np.array(self.by_state).T + command @ np.array(self.by_command).T


ONE_FOR_TWO = Linear(((0.0, 0.0), (0.0, 0.0)), ((1.0,), (0.5,)))
"""One command moves two coordinates together: only targets on a line are held."""


def test_a_target_is_held_alike_by_all_that_ask() -> None:
    targets = np.array([[0.4, 0.2], [0.4, 0.23], [0.4, 0.4], [3.0, 1.5]])
    for noise, held in ((0.0, [True, False, False, False]), (0.03, [True, True, False, False])):
        step_map = Linear(ONE_FOR_TWO.by_state, ONE_FOR_TWO.by_command, noise)
        assert reached_in_one_step(step_map, targets, targets).tolist() == held
        assert [fixed_point(step_map, target).held for target in targets] == held


def test_noise_is_that_of_each_coordinate() -> None:
    step_map = Linear(ONE_FOR_TWO.by_state, ONE_FOR_TWO.by_command, 0.1)
    assert within_noise(step_map, np.zeros(2), np.array([[0.1, -0.1], [0.11, 0.0], [np.nan, 0.0]])).tolist() == [
        True,
        False,
        False,
    ]
    assert reached_in_one_step(step_map, np.empty((0, 2)), np.empty((0, 2))).shape == (0,)


def test_changes_in_one_step_are_those_of_the_closed_form() -> None:
    step_map, rng = LossyHopper(), np.random.default_rng(0)
    states, targets = rng.uniform([0.0, 0.52], [0.4, 0.64], (40, 2)), rng.uniform([-0.4, 0.4], [0.8, 0.8], (40, 2))
    commands = np.array([step_map.command_for(*pair) for pair in zip(states, targets, strict=True)])
    expected = (np.abs(commands) <= [15, 20]).all(axis=1)
    assert 5 < expected.sum() < 35
    np.testing.assert_array_equal(reached_in_one_step(step_map, states, targets), expected)


@pytest.mark.parametrize("unit", [1.0, 0.01])
def test_rank_counts_directions_in_the_given_unit(unit: float) -> None:
    """Both commands push along (0.3, 0.4), and only a little across it."""
    by_command = ((0.3, 0.3 + 0.004), (0.4, 0.4 - 0.003))
    step_map = Linear(((0.0, 0.0), (0.0, 0.0)), by_command)
    effect = command_effect(step_map.space, step_map.jacobian(np.zeros(2), np.zeros(2)), np.full(2, unit))
    expected = 2 * np.linalg.svd(np.array(by_command), compute_uv=False) / unit
    np.testing.assert_allclose(effect.sizes, expected, rtol=1e-6)
    assert effect.rank == 1


def test_delays_count_the_steps_until_a_command_acts() -> None:
    """A chain: the command moves x0, which moves x1 in the next step, and x2 in the one after; x3 stays alone."""
    chain = np.diag([0.2, 0.2, 0.2, 0.9]) + np.diag([0.5, 0.5, 0.0], -1)
    step_map = Linear(tuple(map(tuple, chain)), ((1.0,), (0.0,), (0.0,), (0.0,)))
    effect = command_effect(step_map.space, step_map.jacobian(np.zeros(4), np.zeros(1)), np.full(4, 0.01))
    assert effect.delays.tolist() == [1, 2, 3, 0]
    assert effect.rank == 1
