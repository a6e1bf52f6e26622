"""Robots that follow their command with a lag: plans see the command before, and do not ring."""

from dataclasses import dataclass

import numpy as np
import pytest

from stepgap.control.cautious_controller import CautiousController
from stepgap.control.command_before import MapWithCommand, space_with_command
from stepgap.control.step_controller import StepController
from stepgap.learning.beliefs import Mixture
from stepgap.learning.believed import command_before_of
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, CommandBefore, Quantity, StepSpace, difference_jacobian
from tests.control.maps import ClosedFormMap

SPACE = StepSpace((Quantity("v", "m/s", -0.2, 0.8),), (Quantity("c", "m/s", -0.5, 1.2),))
KEPT = 0.2  # a of y = a y₁ + b₀ c + b₁ c₁; a standing command is followed exactly
NO_FAILURES = np.empty((0, 2))


@dataclass(frozen=True)
class Lagging(ClosedFormMap):
    """y = a y₁ + b₀ c + b₁ c₁, with a known command before."""

    zero: float
    before: float

    @property
    def space(self) -> StepSpace:
        return SPACE

    @property
    def now(self) -> float:
        """b₀."""
        return (1 - KEPT) / (1 - self.zero)

    @property
    def later(self) -> float:
        """b₁."""
        return -self.zero * self.now

    @property
    def command_before(self) -> CommandBefore:
        return CommandBefore(np.array([[self.later]]), np.array([self.before]), np.zeros((1, 1)))

    def next_state(self, state: Array, command: Array) -> Array:
        return KEPT * state + self.now * command + self.later * self.before


def walked(zero: float, greedy: bool, steps: int = 40) -> tuple[Array, Array]:
    """Commands and velocities at the target 0.3 m/s, from standing."""
    velocity, command = np.zeros(1), np.zeros(1)
    commands, velocities = [], []
    for _ in range(steps):
        lagging = Lagging(zero, float(command[0]))
        target = np.array([0.3])
        if greedy:
            command = StepController(lagging)(velocity, target, command).command
        else:
            command = CautiousController(lagging, lagging, NO_FAILURES)(velocity, target, command, [target]).command
        velocity = lagging(velocity, command)
        commands.append(command[0])
        velocities.append(velocity[0])
    return np.array(commands), np.array(velocities)


@pytest.mark.parametrize("zero", [-1.36, -2.35])
def test_a_command_does_not_grow_where_one_step_inversion_rings_up_to_the_bounds(zero: float) -> None:
    greedy, _ = walked(zero, greedy=True)
    assert np.ptp(greedy[-6:]) > 0.9 * np.ptp([-0.5, 1.2]), "it goes from one bound to the other"
    commands, velocities = walked(zero, greedy=False)
    away = np.abs(commands - 0.3)
    assert away.max() == away[:2].max(), "the first commands are the farthest from the standing one"
    assert away[10:].max() < 5e-3
    np.testing.assert_allclose(velocities[10:], 0.3, atol=5e-3)


def test_the_map_with_the_command_before_is_that_of_the_equation() -> None:
    lagging = Lagging(-1.5, 0.1)
    whole = MapWithCommand(lagging, space_with_command(SPACE), lagging.command_before, np.zeros(1))
    assert whole.space.state_names == ("v", "c_before")
    assert whole.space.tracked.tolist() == [True, False]
    state, command = np.array([[0.2, 0.4], [0.3, -0.1]]), np.array([[0.5], [0.0]])
    now, later = 0.8 / 2.5, 1.2 / 2.5
    expected = np.column_stack([0.2 * state[:, 0] + now * command[:, 0] + later * state[:, 1], command[:, 0]])
    np.testing.assert_allclose(whole(state, command), expected, rtol=0, atol=1e-12)
    jacobian = whole.jacobian(state, command)
    np.testing.assert_allclose(jacobian, difference_jacobian(whole, state, command), rtol=0, atol=1e-8)


def test_an_error_that_acts_on_is_a_part_of_the_effect_of_the_command_before() -> None:
    """Beliefs know error and command of the step before, and cannot tell what each of them does to the next one."""
    lag = AffineMap(SPACE, np.zeros(1), np.zeros(1), np.zeros(1), np.array([[KEPT, 1 - KEPT]]))
    weights = np.array([[0.0, 0.0, -0.3, 0.1]])  # the last two are of error and command before, in half ranges
    mixture = Mixture(weights, np.zeros((1, 4, 4)), np.ones(1), np.zeros(2), np.zeros(1))
    before = command_before_of(lag, mixture)
    np.testing.assert_allclose(before.memory, [[-0.3]])
    in_units = 0.1 * SPACE.state_scale / SPACE.command_scale
    np.testing.assert_allclose(before.effect, [in_units + 0.3 * (1 - KEPT)])
