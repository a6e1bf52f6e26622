"""States that are far outside their ranges of use, as in degrees, are named; others are not."""

import numpy as np
import pytest

from stepgap.experiment.outcome import far_states
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import Array, Quantity, StepRecord, StepSpace, StepStatus

SPACE = StepSpace((Quantity("angle", "rad", -0.3, 0.3), Quantity("height", "m", 0.5, 0.7)), (Quantity("u", "", 0, 1),))


def log(*states: tuple[float, float], iteration: int = 0) -> Steps:
    """Steps that start in these states."""

    def step(number: int, state: Array) -> LoggedStep:
        record = StepRecord(state, np.zeros(1), np.zeros(1), state, StepStatus.OK)
        return LoggedStep(iteration, number, state, state, np.zeros(2), record)

    return Steps(SPACE, (step(number, np.array(state)) for number, state in enumerate(states, 1)))


@pytest.mark.parametrize("angles", [[0.2, -0.25, 0.1, -0.3, 0.2], [2.0, 2.0, 0.1, -2.0, 2.0], [90, -90, 0.1, 0.2, 0.3]])
def test_a_robot_that_leaves_its_range_or_jumps_at_times_is_not_named(angles: list[float]) -> None:
    assert not list(far_states(log(*((angle, 0.9) for angle in angles))))  # 0.9 m: one width above the range


def test_degrees_that_change_sign_and_millimetres_are_named_with_value_range_and_unit() -> None:
    states = [(angle, 612.0) for angle in (12.0, -14.0, 9.0, -11.0, 13.0, 0.0, 0.0, 0.0)]
    angle, height = far_states(log(*states, iteration=2))
    assert angle.startswith("In the first 5 steps of deployment 2, angle was about 12, but its range of use is -0.3 to")
    assert "height was about 612, but its range of use is 0.5 to 0.7 m: check the unit" in height


def test_one_step_is_enough_and_none_says_nothing() -> None:
    assert next(iter(far_states(log((0.0, 550.0))))).startswith(
        "In the first step of deployment 0, height was about 550"
    )
    assert not list(far_states(log()))
