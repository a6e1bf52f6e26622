"""The identified model, on robots with known errors."""

import numpy as np
import pytest

from benchmarks.learning.methods.physical_parameters import AdjustedMap, PhysicalError, identify, with_error
from stepgap.learning.observations import observe
from stepgap.step import difference_jacobian
from tests.benchmarks.learning.methods.known_robots import NOMINAL, steps_of


def test_the_adjusted_map_has_the_derivative_of_its_values() -> None:
    adjusted = AdjustedMap(NOMINAL, np.array([0.05, -0.02]), command_scale=0.7)
    state, command = [0.2, 0.58], [2.0, -5.0]
    np.testing.assert_allclose(adjusted(state, command) - adjusted.shift, NOMINAL(state, [1.4, -3.5]))
    np.testing.assert_allclose(
        adjusted.jacobian(state, command), difference_jacobian(adjusted, state, command), rtol=1e-3, atol=1e-6
    )


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_identification_predicts_new_steps(noise: float) -> None:
    error = PhysicalError(0.1, -0.1, 0.2, -0.1, -0.15, 0.03, 0.002, -0.003)
    truth = with_error(NOMINAL, error)
    found = identify(NOMINAL, observe(steps_of(truth, 60, noise), NOMINAL))
    state, command = np.array([[0.15, 0.57], [0.3, 0.6]]), np.array([[-3.0, -5.0], [1.0, 0.0]])
    wrong = NOMINAL.evaluate(state, command).next_state - truth.evaluate(state, command).next_state
    left = found.evaluate(state, command).next_state - truth.evaluate(state, command).next_state
    assert np.linalg.norm(left) < (0.1 if noise else 0.05) * np.linalg.norm(wrong)


def test_a_robot_equal_to_the_model_is_identified_as_such() -> None:
    found = identify(NOMINAL, observe(steps_of(NOMINAL, 20), NOMINAL))
    assert found.command_scale == pytest.approx(1, abs=1e-6)
    np.testing.assert_allclose(found([0.2, 0.58], [0, 0]), NOMINAL([0.2, 0.58], [0, 0]), atol=1e-6)
