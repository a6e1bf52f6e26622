"""Gain and multipliers of the closed loop against differences of the step controller itself."""

import numpy as np
import pytest

from stepgap.control.closed_loop import largest_multiplier, step_controller_gain
from stepgap.control.limit_cycle import fixed_point
from stepgap.control.step_controller import StepController
from tests.control.maps import LossyHopper

TARGET = np.array([0.2, 0.58])


def test_the_gain_is_the_derivative_of_the_step_controller() -> None:
    step_map = LossyHopper()
    point = fixed_point(step_map, TARGET)
    controller, distance = StepController(step_map), 1e-4 * step_map.space.state_scale
    columns = [
        controller(TARGET + step, TARGET, point.command).command
        - controller(TARGET - step, TARGET, point.command).command
        for step in np.diag(distance)
    ]
    np.testing.assert_allclose(step_controller_gain(step_map, point), np.transpose(columns) / (2 * distance), rtol=1e-3)


def test_one_step_removes_an_error_on_the_map_of_the_controller_and_not_on_another_one() -> None:
    nominal, real = LossyHopper(), LossyHopper(keep=0.9)
    point = fixed_point(nominal, TARGET)
    gain = step_controller_gain(nominal, point)
    assert largest_multiplier(nominal.jacobian(TARGET, point.command), gain) == pytest.approx(0, abs=1e-6)
    assert largest_multiplier(nominal.jacobian(TARGET, point.command)) == pytest.approx(
        abs(point.floquet_multipliers[0])
    )
    assert largest_multiplier(real.jacobian(TARGET, point.command), gain) == pytest.approx(0.2, abs=1e-6)


def test_without_a_jacobian_there_is_no_multiplier() -> None:
    found = largest_multiplier(np.array([[[0.5, 1.0]], [[np.nan, 1.0]]]), np.array([[-0.2]]))
    np.testing.assert_allclose(found, [0.3, np.nan])
