"""Affine nominal maps: templates, and recursive least squares against its batch solution."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.learning.methods.affine import linearised, mean_target, one_digit, rls_settings, template
from benchmarks.learning.methods.physical_parameters import AdjustedMap
from benchmarks.learning.tasks import square_reference
from stepgap.control.step_controller import StepController
from stepgap.learning.learner import Learner
from stepgap.learning.polynomial import PRIOR_STD
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import StepStatus, difference_jacobian
from tests.benchmarks.learning.methods.known_robots import NOMINAL, steps_of

REFERENCE = paper_reference()
POINTS = np.array([[0.1, 0.57], [0.3, 0.6]]), np.array([[2.0, -5.0], [-6.0, 3.0]])


def test_an_affine_map_is_one_and_fails_only_without_numbers() -> None:
    found = linearised(NOMINAL, REFERENCE)
    state, command = POINTS
    np.testing.assert_allclose(found.jacobian(state, command), difference_jacobian(found, state, command), atol=1e-9)
    assert found.evaluate([9.0, -3.0], [1e4, 0.0]).status == StepStatus.OK
    next_state, status = found.evaluate([[0.2, 0.58], [np.nan, 0.58]], command)
    assert status.tolist() == [StepStatus.OK, StepStatus.INVALID]
    np.testing.assert_array_equal(np.isnan(next_state), [[False, False], [True, True]])
    assert np.isnan(found.jacobian([0.2, 0.58], [np.inf, 0])).all()


def test_the_linearised_map_touches_the_nominal_one_in_its_limit_cycle() -> None:
    found = linearised(NOMINAL, REFERENCE)
    np.testing.assert_allclose(found(found.state, found.command), found.state, atol=1e-6)
    near = found.command + np.array([0.1, -0.1])
    np.testing.assert_allclose(found(found.state, near), NOMINAL(found.state, near), atol=1e-5)


def test_the_template_has_one_digit_of_the_effect_of_commands_and_no_memory() -> None:
    exact, crude = linearised(NOMINAL, REFERENCE), template(NOMINAL, REFERENCE)
    assert not crude.matrix[:, :2].any()
    for true, used in zip(exact.matrix[:, 2:].ravel(), crude.matrix[:, 2:].ravel(), strict=True):
        assert used / 0.7 == pytest.approx(float(f"{true:.0e}"))
        assert 0.6 < used / true < 0.8 * 1.1, "some digits are lost, but not the sign or the size"
    target = np.array([0.3, 0.6])
    commands = [StepController(crude)(state, target).command for state in POINTS[0]]
    np.testing.assert_allclose(commands[0], commands[1], err_msg="it forgets the state")


def test_numbers_are_rounded_to_one_digit() -> None:
    np.testing.assert_allclose(one_digit(np.array([[0.0149, -265.0], [0.0, 9.6e-7]])), [[0.01, -300], [0, 1e-6]])


def test_the_mean_target_is_that_after_the_start() -> None:
    np.testing.assert_allclose(mean_target(REFERENCE), REFERENCE.targets[19:].mean(axis=0))
    np.testing.assert_allclose(mean_target(square_reference()), [0.25, 0.6], atol=0.002)


def test_recursive_least_squares_is_the_weighted_batch_solution() -> None:
    factor = 0.9
    nominal = linearised(NOMINAL, REFERENCE)
    truth = AdjustedMap(nominal, np.array([0.03, -0.01]), command_scale=0.8)
    before, now = steps_of(truth, 20, noise=0.5), steps_of(truth, 10, noise=0.5, iteration=1)
    learner = Learner.start(nominal, before, replace(rls_settings(factor), drift=False), 1)
    for logged in now:
        learner = learner.after(logged)

    def features(state: np.ndarray, command: np.ndarray) -> np.ndarray:
        space = nominal.space
        state, command = (state - space.state_centre) / space.state_scale, space.point_of(command)
        return np.hstack([np.ones((len(state), 1)), state, command])

    state, command, after = (
        np.vstack([getattr(log, name) for log in (before, now)]) for name in ("state", "requested", "next_state")
    )
    known, error = features(state, command), after - nominal.evaluate(state, command).next_state
    weight = factor ** np.arange(len(known))[::-1]
    information = (known.T * weight) @ known + np.eye(5) / PRIOR_STD**2
    coefficients = np.linalg.solve(information, (known.T * weight) @ error)
    expected = nominal.evaluate(*POINTS).next_state + features(*POINTS) @ coefficients
    np.testing.assert_allclose(learner.step_map().evaluate(*POINTS).next_state, expected, rtol=1e-9)
    assert isinstance(learner.nominal, AffineMap)
