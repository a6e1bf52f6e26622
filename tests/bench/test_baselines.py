"""The integral correction and the identified model, on robots with known errors."""

import numpy as np
import pytest

from stepgap.bench.baselines import INTEGRAL_GAIN, AdjustedMap, IntegralCorrection, PhysicalError, identify, with_error
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.robots.hopper.apex_map import ApexMap
from stepgap.step import StepMap, StepRecord, StepStatus, difference_jacobian

NOMINAL = ApexMap()


def steps_of(truth: StepMap, count: int, noise: float = 0.0) -> StepLog:
    """Random steps of a map."""
    rng = np.random.default_rng(0)
    steps: list[LoggedStep] = []
    for number in range(1, count + 1):
        state = rng.uniform([0.05, 0.56], [0.35, 0.62])
        command = rng.uniform([-8, -12], [4, 4])
        next_state = truth(state, command) + noise * rng.standard_normal(2) * [0.01, 0.002]
        record = StepRecord(state, command, command, next_state, StepStatus.OK)
        steps.append(LoggedStep(0, number, state, state, np.zeros(2), record))
    return StepLog(NOMINAL.space, steps)


def test_the_adjusted_map_has_the_derivative_of_its_values() -> None:
    adjusted = AdjustedMap(NOMINAL, np.array([0.05, -0.02]), command_scale=0.7)
    state, command = [0.2, 0.58], [2.0, -5.0]
    np.testing.assert_allclose(adjusted(state, command) - adjusted.shift, NOMINAL(state, [1.4, -3.5]))
    np.testing.assert_allclose(
        adjusted.jacobian(state, command), difference_jacobian(adjusted, state, command), rtol=1e-3, atol=1e-6
    )


def test_the_integral_follows_a_constant_error() -> None:
    shift = np.array([0.05, -0.02])
    truth = AdjustedMap(NOMINAL, shift)
    log = steps_of(truth, 3)
    learner = IntegralCorrection.start(NOMINAL, StepLog(NOMINAL.space))
    state, command = [0.2, 0.58], [2.0, -5.0]
    for count, logged in enumerate(log, start=1):
        learner = learner.after(logged)
        added = learner.step_map()(state, command) - NOMINAL(state, command)
        np.testing.assert_allclose(added, (1 - (1 - INTEGRAL_GAIN) ** count) * shift)
    state, command = list(log)[-1].record.state, list(log)[-1].record.command
    known_before = IntegralCorrection.start(NOMINAL, log)
    np.testing.assert_allclose(known_before.step_map()(state, command), learner.step_map()(state, command))


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_identification_predicts_new_steps(noise: float) -> None:
    error = PhysicalError(0.1, -0.1, 0.2, -0.1, -0.15, 0.03, 0.002, -0.003)
    truth = with_error(NOMINAL, error)
    found = identify(NOMINAL, steps_of(truth, 60, noise))
    state, command = np.array([[0.15, 0.57], [0.3, 0.6]]), np.array([[-3.0, -5.0], [1.0, 0.0]])
    wrong = NOMINAL.evaluate(state, command).next_state - truth.evaluate(state, command).next_state
    left = found.evaluate(state, command).next_state - truth.evaluate(state, command).next_state
    assert np.linalg.norm(left) < (0.1 if noise else 0.05) * np.linalg.norm(wrong)


def test_a_robot_equal_to_the_model_is_identified_as_such() -> None:
    found = identify(NOMINAL, steps_of(NOMINAL, 20))
    assert found.command_scale == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(found([0.2, 0.58], [0, 0]), NOMINAL([0.2, 0.58], [0, 0]), atol=1e-6)
