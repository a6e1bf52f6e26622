"""Multipliers from recorded steps, on linear closed loops whose multipliers are known."""

import numpy as np
import pytest

from stepgap.learning.steps import LoggedStep, Steps
from stepgap.report.measured_loop import measured_loop
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus

SPACE = StepSpace((Quantity("speed", "m/s", -1, 1), Quantity("height", "m", 0, 1)), (Quantity("push", "N", -1, 1),))


def recorded(matrix: Array, rng: np.random.Generator, visits: int = 19, length: int = 12) -> Steps:
    """Steps whose error of the state is multiplied by a matrix, with an offset for each target, and noise."""
    state, steps = np.array([0.0, 0.5]), list[LoggedStep]()
    for visit in range(visits):
        target, offset = np.array([0.1 * (visit % 4), 0.5 + 0.02 * (visit % 5)]), rng.normal(size=2) * [0.03, 0.002]
        for _ in range(length):
            reached = target + matrix @ (state - target) + offset + rng.normal(size=2) * [0.01, 0.001]
            record = StepRecord(state, np.zeros(1), np.zeros(1), reached, StepStatus.OK)
            steps.append(LoggedStep(3, len(steps) + 1, target, target, np.zeros(2), record))
            state = reached
    return Steps(SPACE, steps)


@pytest.mark.parametrize("matrix", [[[0.4, 0.0], [0.0, -0.2]], [[0.8, 0.0], [0.01, 0.3]], [[0.2, -5.0], [0.04, 0.2]]])
def test_intervals_contain_the_multiplier_about_as_often_as_they_say(matrix) -> None:
    true = np.abs(np.linalg.eigvals(matrix)).max()
    rng, inside, estimates = np.random.default_rng(1), 0, []
    for _ in range(60):
        found = measured_loop(recorded(np.asarray(matrix), rng))
        assert found is not None
        assert (found.iteration, found.steps) == (3, 19 * 11)
        inside += found.interval[0] <= true <= found.interval[1]
        estimates.append(found.largest)
    assert inside >= 52
    assert np.mean(estimates) == pytest.approx(true, abs=0.08)


def test_a_loop_that_removes_errors_in_one_step_is_not_mistaken_for_one_that_keeps_them() -> None:
    rng = np.random.default_rng(3)
    found = [measured_loop(recorded(np.zeros((2, 2)), rng)) for _ in range(20)]
    assert np.mean([each.largest for each in found if each]) < 0.1
    assert max(each.interval[1] for each in found if each) < 0.35


def test_too_few_steps_give_no_multiplier() -> None:
    rng = np.random.default_rng(2)
    assert measured_loop(recorded(np.zeros((2, 2)), rng, visits=19, length=1)) is None
    assert measured_loop(recorded(np.zeros((2, 2)), rng, visits=2, length=9)) is None
