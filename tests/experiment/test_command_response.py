"""Whether steps show the effect of their commands, for robots that follow them at once, later or not at all."""

import numpy as np
import pytest

from stepgap.control.step_controller import StepController
from stepgap.experiment.command_response import CommandResponse, command_response
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, StepRecord, StepStatus
from tests.control.maps import LossyHopper

NOMINAL = LossyHopper()
NOISE = np.array([0.01, 0.002])
MIDDLE = np.array([0.2, 0.58])
HOLDING = StepController(NOMINAL)(MIDDLE, MIDDLE).command
"""The command that keeps the state in the middle."""
COUNT = 120


def steps_of(count: int, seed: int) -> Steps:
    """Steps with random commands of a robot whose error is a function of its state, and noise."""
    rng, steps = np.random.default_rng(seed), []
    state = MIDDLE
    for number in range(1, count + 1):
        command = HOLDING + rng.uniform([-6, -3], [6, 3])
        error = np.array([0.02, 0.002]) + np.array([0.1, 0.2]) * (state - MIDDLE) + NOISE * rng.normal(size=2)
        record = StepRecord(state, command, command, NOMINAL(state, command) + error, StepStatus.OK)
        steps.append(LoggedStep(0, number, state, record.next_state, NOISE, record))
        state = record.next_state
    return Steps(NOMINAL.space, steps)


def response(seed: int, delays: tuple[int | None, int | None], varied: float = 1.0) -> CommandResponse:
    """Of a robot each of whose coordinates follows the command of some steps before, or a constant one."""
    rng = np.random.default_rng(seed)
    commands = HOLDING + varied * rng.uniform([-6, -3], [6, 3], (COUNT, 2))
    state, states, ends = MIDDLE, list[Array](), list[Array]()
    for number in range(COUNT):
        acting = [HOLDING if delay is None else commands[max(number - delay, 0)] for delay in delays]
        after = np.array([NOMINAL(state, command)[row] for row, command in enumerate(acting)])
        after += NOISE * rng.normal(size=2)
        states.append(state)
        ends.append(after)
        state = after
    log = Steps.of_columns(NOMINAL.space, state=np.array(states), command=commands, next_state=np.array(ends))
    found = command_response(log, NOMINAL)
    assert found is not None
    return found


@pytest.mark.parametrize("seed", range(5))
def test_each_coordinate_is_judged_alone(seed: int) -> None:
    found = response(seed, (0, 0))
    assert (found.acts.tolist(), found.acts_later.tolist()) == ([True, True], [False, False])
    found = response(seed, (1, 0))
    assert (found.acts.tolist(), found.acts_later.tolist()) == ([False, True], [True, False])
    found = response(seed, (0, None))
    assert (found.acts.tolist(), found.acts_later.tolist()) == ([True, False], [False, False])
    assert found.expected.all()


def test_commands_that_hardly_vary_show_nothing() -> None:
    found = response(0, (None, None), varied=1e-3)
    assert not found.expected.any()


def test_few_steps_are_not_judged() -> None:
    log = Steps.of_columns(NOMINAL.space, state=np.tile(MIDDLE, (20, 1)), command=np.tile(HOLDING, (20, 1)))
    assert command_response(log, NOMINAL) is None
