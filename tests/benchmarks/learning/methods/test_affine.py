"""Affine nominal maps: the template."""

import numpy as np
import pytest

from benchmarks.learning.methods.affine import one_digit, template
from stepgap.control.step_controller import StepController
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.step import StepStatus, difference_jacobian
from tests.benchmarks.learning.methods.known_robots import NOMINAL

REFERENCE = paper_reference()
POINTS = np.array([[0.1, 0.57], [0.3, 0.6]]), np.array([[2.0, -5.0], [-6.0, 3.0]])


def test_an_affine_map_is_one_and_fails_only_without_numbers() -> None:
    found = linearised(NOMINAL, REFERENCE.mean_target)
    state, command = POINTS
    np.testing.assert_allclose(found.jacobian(state, command), difference_jacobian(found, state, command), atol=1e-9)
    assert found.evaluate([9.0, -3.0], [1e4, 0.0]).status == StepStatus.OK
    next_state, status = found.evaluate([[0.2, 0.58], [np.nan, 0.58]], command)
    assert status.tolist() == [StepStatus.OK, StepStatus.INVALID]
    np.testing.assert_array_equal(np.isnan(next_state), [[False, False], [True, True]])
    assert np.isnan(found.jacobian([0.2, 0.58], [np.inf, 0])).all()


def test_the_template_has_one_digit_of_the_effect_of_commands_and_no_memory() -> None:
    exact, crude = linearised(NOMINAL, REFERENCE.mean_target), template(NOMINAL, REFERENCE)
    assert not crude.matrix[:, :2].any()
    for true, used in zip(exact.matrix[:, 2:].ravel(), crude.matrix[:, 2:].ravel(), strict=True):
        assert used / 0.7 == pytest.approx(float(f"{true:.0e}"))
        assert 0.6 < used / true < 0.8 * 1.1, "some digits are lost, but not the sign or the size"
    target = np.array([0.3, 0.6])
    commands = [StepController(crude)(state, target).command for state in POINTS[0]]
    np.testing.assert_allclose(commands[0], commands[1], err_msg="it forgets the state")


def test_numbers_are_rounded_to_one_digit() -> None:
    np.testing.assert_allclose(one_digit(np.array([[0.0149, -265.0], [0.0, 9.6e-7]])), [[0.01, -300], [0, 1e-6]])
