"""Maps fitted to recorded steps, against the robot that made the steps."""

from dataclasses import replace

import numpy as np
import pytest

from stepgap.base.errors import StepGapError
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.robots.nominal_maps.log_map import fit_log_map
from stepgap.step import StepRecord, StepStatus, difference_jacobian
from tests.control.maps import LossyHopper

ROBOT = LossyHopper()
SPACE = ROBOT.space
UNCHANGED = np.eye(2)
NOISE = np.array([0.01, 0.002])


def recorded(count: int, seed: int = 0, change: np.ndarray = UNCHANGED) -> Steps:
    """Steps with random commands about those that keep the robot at (0.2 m/s, 0.58 m), with noise.

    Their changes are multiplied by a matrix.
    """
    rng, steps, state = np.random.default_rng(seed), [], np.array([0.2, 0.58])
    holding = ROBOT.command_for(state, state)
    for number in range(1, count + 1):
        command = holding + change @ rng.uniform([-6, -3], [6, 3])
        next_state = ROBOT(state, command) + NOISE * rng.normal(size=2)
        record = StepRecord(state, command, command, next_state, StepStatus.OK)
        steps.append(LoggedStep(0, number, state, next_state, NOISE, record))
        state = next_state
    return Steps(SPACE, steps)


def test_it_predicts_unseen_steps_up_to_their_noise() -> None:
    found, unseen = fit_log_map(recorded(80)), recorded(200, seed=1)
    error = found(unseen.state, unseen.requested) - unseen.next_state
    assert (np.sqrt(np.mean(error**2, axis=0)) < 1.3 * NOISE).all()


def test_its_slopes_are_those_of_the_robot() -> None:
    found, state = fit_log_map(recorded(300)), np.array([0.2, 0.58])
    command = ROBOT.command_for(state, state)
    wide = np.concatenate([SPACE.state_scale, SPACE.command_scale])
    difference = (found.jacobian(state, command) - ROBOT.jacobian(state, command)) * wide / SPACE.state_scale[:, None]
    assert np.abs(difference).max() < 0.15
    np.testing.assert_allclose(found.jacobian(state, command), difference_jacobian(found, state, command), atol=1e-6)


def test_too_few_steps_are_refused_and_no_number_is_invalid() -> None:
    with pytest.raises(StepGapError, match="5 completed steps, but a map needs at least 6"):
        fit_log_map(recorded(5))
    found = fit_log_map(recorded(6))
    assert found.evaluate([0.2, np.nan], [0, 0]).status == StepStatus.INVALID
    assert np.isnan(found.jacobian([0.2, np.nan], [0, 0])).all()
    assert found.evaluate([5.0, 2.0], [0, 0]).status == StepStatus.OK


def test_a_command_that_did_not_vary_has_no_effect() -> None:
    free, fixed = fit_log_map(recorded(80)), fit_log_map(recorded(80, change=np.diag([0.0, 1.0])))
    assert free.gaps == ()
    assert fixed.gaps == ("fx did not vary in the log, so its effect is unknown: the map has none",)
    jacobian = fixed.jacobian([0.2, 0.58], [3.0, 0.0])
    assert (jacobian[:, 2] == 0).all()
    assert jacobian[1, 3] == pytest.approx(free.jacobian([0.2, 0.58], [0.0, 0.0])[1, 3], rel=0.2)


def test_nothing_is_known_from_one_repeated_step() -> None:
    (first, *_) = recorded(1)
    repeated = fit_log_map(Steps(SPACE, [replace(first, step=number) for number in range(60)]))
    assert len(repeated.gaps) == 4
    assert (repeated.jacobian([0.2, 0.58], [0.0, 0.0]) == 0).all()
    record = first.record
    np.testing.assert_allclose(repeated(record.state, record.command), record.next_state, atol=0.01)


def test_commands_that_vary_only_together_are_named() -> None:
    (gap,) = fit_log_map(recorded(80, change=np.array([[0.0, 2.0], [0.0, 1.0]]))).gaps
    assert gap == "fx, fy vary only together in the log, so only their common effect is known; vary each alone"
