"""The record of steps in memory."""

import math
from dataclasses import replace

import numpy as np

from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.step import Quantity, StepRecord, StepSpace, StepStatus

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)),
    (Quantity("fx", "N", -15, 15), Quantity("fy", "N", -20, 20)),
)
NO_STATE = np.full(2, np.nan)


def step(iteration: int = 0, number: int = 1, status: StepStatus = StepStatus.OK, offset: float = 0.0) -> LoggedStep:
    next_state = np.array([0.1 + 0.01 * number + offset, 0.55]) if status == StepStatus.OK else NO_STATE
    record = StepRecord(np.array([0.1, 0.55]), np.array([1.0, -2.0]), np.array([0.5, -2.0]), next_state, status)
    return LoggedStep(iteration, number, np.array([0.2, 0.58]), np.array([0.2, 0.58]), np.zeros(2), record)


def test_the_yaw_of_a_step_is_where_the_one_before_ended() -> None:
    first = [step(), step(number=2), step(number=3)]
    yaws = [0.5, math.nan, 7.0]
    known = [replace(s, record=replace(s.record, yaw_after=yaw)) for s, yaw in zip(first, yaws, strict=True)]
    np.testing.assert_array_equal(StepLog(SPACE, [*known, step(1, 1)]).yaw, [math.nan, 0.5, math.nan, math.nan])
    assert StepLog(SPACE).yaw.shape == (0,)
    left_out = StepLog(SPACE, [known[0], known[2]])
    np.testing.assert_array_equal(left_out.yaw, [math.nan, math.nan])


def test_the_log_by_columns() -> None:
    log = StepLog(SPACE, [step(), step(number=2, status=StepStatus.FELL), step(1, 1)])
    assert (len(log), log.failed_steps, log.iterations) == (3, 1, [0, 1])
    assert len(log.completed()) == 2
    assert len(log.of_iteration(1)) == 1
    for column in (log.state, log.applied, log.next_state, log.target, log.predicted, log.std):
        assert column.shape == (3, 2)
    assert StepLog(SPACE).next_state.shape == (0, 2)
