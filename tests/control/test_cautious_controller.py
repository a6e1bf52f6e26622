"""Cautious control against a fine grid of commands: least expected squared distance, and no step that may fail."""

from dataclasses import dataclass

import numpy as np
import pytest
from numpy.typing import ArrayLike

from stepgap.control.cautious_controller import FAILURE_RADIUS, RISK, CautiousController
from stepgap.control.command_table import build_table
from stepgap.control.goal import CAUTION
from stepgap.control.settings import ControlSettings
from stepgap.control.step_controller import StepController
from stepgap.step import Array, Codes, StepMap, StepStatus
from tests.control.maps import ClosedFormMap, LossyHopper

NONE = np.empty((0, 4))
STATE, TARGET = np.array([0.2, 0.58]), np.array([0.3, 0.6])


@dataclass(frozen=True)
class Guessed(ClosedFormMap):
    """A map whose uncertainty grows with the distance of the command from one that was tried."""

    truth: LossyHopper = LossyHopper(loss=0.45)
    tried: tuple[float, float] = (0.0, 0.0)
    growth: tuple[float, float] = (0.004, 0.002)
    least: float = 0.0005
    noise: float = 0.001

    @property
    def space(self):
        return self.truth.space

    def next_state(self, state: Array, command: Array) -> Array:
        return self.truth.next_state(state, command)

    @property
    def noise_std(self) -> Array:
        return np.full(2, self.noise)

    def std(self, state: ArrayLike, command: ArrayLike) -> Array:
        state, command = np.broadcast_arrays(np.asarray(state, float), np.asarray(command, float))
        distance = np.sqrt(1 + np.sum((command - self.tried) ** 2, axis=-1, keepdims=True))
        return self.least * np.ones(2) + np.array(self.growth) * (distance - 1)

    def std_gradient(self, state: ArrayLike, command: ArrayLike) -> Array:  # noqa: ARG002
        command = np.asarray(command, float)
        away = command - self.tried
        slope = away / np.sqrt(1 + np.sum(away**2, axis=-1, keepdims=True))
        gradient = np.zeros((*np.shape(command)[:-1], 2, 4))
        gradient[..., 2:] = np.array(self.growth)[:, None] * slope[..., None, :]
        return gradient


def expected(step_map: StepMap, state: Array, target: Array, command: Array) -> Array:
    error = step_map.evaluate(state, command).next_state - target
    deviation = CAUTION * step_map.std(state, command)
    return np.sum((error**2 + deviation**2) / step_map.space.state_scale**2, axis=-1)


def commands_on_a_grid(step_map: StepMap, count: int) -> Array:
    axes = [np.linspace(quantity.lower, quantity.upper, count) for quantity in step_map.space.command]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 2)


def test_a_certain_map_gets_the_exact_command() -> None:
    sure = LossyHopper()
    cautious = CautiousController(sure, sure, NONE)(STATE, TARGET)
    np.testing.assert_array_equal(cautious.command, StepController(sure)(STATE, TARGET).command)
    np.testing.assert_allclose(cautious.predicted, TARGET, atol=1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_an_uncertain_map_gets_the_least_expected_squared_distance(seed: int) -> None:
    rng = np.random.default_rng(seed)
    guessed = Guessed(tried=tuple(rng.uniform([-10, -15], [10, 15])), growth=tuple(rng.uniform(0.001, 0.02, 2)))
    state, target = rng.uniform([0.0, 0.54], [0.4, 0.62]), rng.uniform([0.0, 0.54], [0.4, 0.62])
    plan = CautiousController(guessed, LossyHopper(), NONE)(state, target)
    grid = commands_on_a_grid(guessed, 201)
    assert expected(guessed, state, target, plan.command) <= expected(guessed, state, target, grid).min() * (1 + 1e-6)


def test_never_worse_than_the_command_of_the_nominal_map() -> None:
    rng, nominal = np.random.default_rng(0), LossyHopper()
    for _ in range(50):
        guessed = Guessed(tried=tuple(rng.uniform([-10, -15], [10, 15])), growth=tuple(rng.uniform(0.001, 0.05, 2)))
        state, target = rng.uniform([0.0, 0.54], [0.4, 0.62]), rng.uniform([0.0, 0.54], [0.4, 0.62])
        cautious = CautiousController(guessed, nominal, NONE)(state, target).command
        uncorrected = StepController(nominal)(state, target).command
        assert expected(guessed, state, target, cautious) <= expected(guessed, state, target, uncorrected) + 1e-12


def test_a_step_like_one_that_failed_is_not_taken_again() -> None:
    sure = LossyHopper()
    exact = StepController(sure)(STATE, TARGET).command
    failed = np.array([[*STATE, *exact]])
    plan = CautiousController(sure, sure, failed)(STATE, TARGET)
    apart = np.abs(plan.command - exact) / sure.space.command_scale
    assert apart.max() >= FAILURE_RADIUS
    grid = commands_on_a_grid(sure, 9)
    allowed = (np.abs(grid - exact) / sure.space.command_scale).max(axis=1) >= FAILURE_RADIUS
    assert expected(sure, STATE, TARGET, plan.command) <= expected(sure, STATE, TARGET, grid[allowed]).min() + 1e-12


@dataclass(frozen=True)
class Cliff(LossyHopper):
    """States above a height are not viable."""

    edge: float = 0.62

    def status(self, state: Array, command: Array) -> Codes:
        high = np.broadcast_to(state[..., 1] > self.edge, np.broadcast_shapes(state.shape, command.shape)[:-1])
        return np.where(high, StepStatus.FELL, StepStatus.OK)


@dataclass(frozen=True)
class GuessedCliff(Guessed):
    """The same map with uncertainty."""

    truth: LossyHopper = Cliff()

    def status(self, state: Array, command: Array) -> Codes:
        return self.truth.status(state, command)


def test_it_avoids_states_that_are_not_viable() -> None:
    cliff, target = GuessedCliff(growth=(0.0, 0.0), least=0.002), np.array([0.2, 0.618])
    plan = CautiousController(cliff, cliff.truth, NONE)(STATE, target)
    np.testing.assert_allclose(plan.std, np.hypot(cliff.std(STATE, plan.command), cliff.noise), rtol=1e-12)
    spread = RISK * plan.std[1]
    assert plan.predicted[1] + spread <= Cliff().edge
    assert StepController(cliff)(STATE, target).predicted[1] + spread > Cliff().edge


def test_if_no_command_is_safe_the_best_one_is_taken() -> None:
    cliff = GuessedCliff(growth=(0.0, 0.0), least=0.5)
    plan = CautiousController(cliff, cliff.truth, NONE)(STATE, TARGET)
    assert np.isfinite(plan.command).all()


NO_RULES = ControlSettings(cautious=False, viability=False, avoid_failures=False)


def test_without_rules_the_command_is_that_of_equation_13() -> None:
    guessed = Guessed(tried=(5.0, -5.0), growth=(0.02, 0.02))
    exact = StepController(guessed)(STATE, TARGET).command
    failed = np.append(STATE, exact)[None]
    plan = CautiousController(guessed, LossyHopper(), failed, NO_RULES)(STATE, TARGET)
    np.testing.assert_array_equal(plan.command, exact)
    assert not np.allclose(CautiousController(guessed, LossyHopper(), failed)(STATE, TARGET).command, exact, atol=0.1)


def test_each_rule_can_be_switched_off() -> None:
    guessed = Guessed(tried=(5.0, -5.0), growth=(0.02, 0.02))
    exact = StepController(guessed)(STATE, TARGET).command
    off = ControlSettings(cautious=False)
    np.testing.assert_array_equal(CautiousController(guessed, LossyHopper(), NONE, off)(STATE, TARGET).command, exact)

    sure, failed = LossyHopper(), np.append(STATE, StepController(LossyHopper())(STATE, TARGET).command)[None]
    off = ControlSettings(avoid_failures=False)
    np.testing.assert_array_equal(CautiousController(sure, sure, failed, off)(STATE, TARGET).command, failed[0, 2:])

    cliff, target = GuessedCliff(growth=(0.0, 0.0), least=0.0, noise=0.002), np.array([0.2, 0.618])
    exact = StepController(cliff)(STATE, target)
    assert not CautiousController(cliff, cliff.truth, NONE).is_safe(STATE, exact.command)
    off = CautiousController(cliff, cliff.truth, NONE, ControlSettings(viability=False))
    np.testing.assert_array_equal(off(STATE, target).command, exact.command)


def test_a_table_replaces_solving() -> None:
    sure = LossyHopper()
    table = build_table(sure, 3)
    plan = CautiousController(sure, sure, NONE, NO_RULES, table)(STATE, TARGET)
    found = table(STATE, TARGET)
    np.testing.assert_array_equal(plan.command, found.command)
    np.testing.assert_array_equal(plan.predicted, found.predicted)
    assert not np.array_equal(plan.command, StepController(sure)(STATE, TARGET).command), "it is interpolated"
