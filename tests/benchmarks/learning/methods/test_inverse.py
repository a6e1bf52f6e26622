"""The command's error: the inverse of a map, and what is learned with it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.learning.methods.inverse import InverseMap, inverse_of
from benchmarks.learning.methods.physical_parameters import AdjustedMap
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.nominal_maps.linearised_map import linearised
from stepgap.step import StepStatus
from tests.benchmarks.learning.methods.known_robots import NOMINAL, steps_of

INVERSE = inverse_of(NOMINAL)


def test_the_inverse_returns_the_command_of_a_step() -> None:
    state, command = np.array([[0.1, 0.57], [0.3, 0.6]]), np.array([[2.0, -5.0], [-6.0, 3.0]])
    after = NOMINAL.evaluate(state, command).next_state
    found = INVERSE.evaluate(state, after)
    np.testing.assert_allclose(INVERSE.as_command(found.next_state), command, atol=1e-3)
    np.testing.assert_allclose(INVERSE.as_state(command), found.next_state, atol=1e-5)
    assert INVERSE.space.command_names == ("next_speed", "next_height")


def test_its_derivative_is_that_of_the_implicit_function() -> None:
    state, command = np.array([0.2, 0.58]), np.array([-3.0, -5.0])
    forward = NOMINAL.jacobian(state, command)
    to_units = np.diag(NOMINAL.space.state_scale / NOMINAL.space.command_scale)
    expected = to_units @ np.linalg.solve(forward[:, 2:], np.hstack([-forward[:, :2], np.eye(2)]))
    found = INVERSE.jacobian(state, NOMINAL(state, command))
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-3)


def test_a_state_out_of_reach_has_no_command_and_commands_beyond_the_bounds_are_known() -> None:
    found = INVERSE.evaluate([0.2, 0.58], [[3.0, 0.58], [np.nan, 0.58]])
    assert found.status.tolist() == [StepStatus.INVALID, StepStatus.INVALID]
    assert np.isnan(found.next_state).all()
    beyond = np.array([0.0, 1.2 * NOMINAL.bounds.fy_upper])
    inverse = InverseMap(linearised(NOMINAL, paper_reference().mean_target), NOMINAL.space)
    with pytest.raises(ValueError, match="as many commands as states"):
        replace(inverse, scales=replace(NOMINAL.space, command=NOMINAL.space.command[:1]))
    np.testing.assert_array_equal(INVERSE.as_command(INVERSE.as_state(beyond)), [0.0, NOMINAL.bounds.fy_upper])


def test_the_learned_command_makes_the_step_of_the_target() -> None:
    truth = AdjustedMap(NOMINAL, np.zeros(2), command_scale=0.8)
    log = steps_of(truth, 80)
    known = Steps(INVERSE.space, map(INVERSE.read_backwards, log))
    learner = Learner.start(INVERSE, known, LearningSettings(), 1)
    state, target = np.array([0.2, 0.58]), np.array([0.25, 0.6])
    plain, learned = (
        INVERSE.as_command(step_map.evaluate(state, target).next_state) for step_map in (INVERSE, learner.step_map())
    )
    np.testing.assert_allclose(learned, plain / 0.8, rtol=0.02, err_msg="the exact inverse of the robot")
    error, before = (np.abs(truth(state, command) - target) for command in (learned, plain))
    assert (error < 0.1 * before).all()
