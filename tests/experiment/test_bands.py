"""The number of steps until the error stays in a band, on synthetic errors and steps."""

import numpy as np
import pytest

from stepgap.experiment.bands import WINDOW, executed_steps_to_band, steps_to_band
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.step import StepRecord, StepStatus
from tests.control.maps import LossyHopper

SPACE = LossyHopper().space
TARGET = np.array([0.2, 0.58])
BAND = np.array([0.02, 0.005])


def log_of(first: int, errors: list[float], falls: bool = False) -> Steps:
    """Steps of a deployment with these errors of speed; the last one may be a fall."""
    steps, size = [], len(TARGET)
    for number, error in enumerate(errors, start=first):
        fell = falls and number == first + len(errors) - 1
        reached = np.full(size, np.nan) if fell else TARGET + np.array([error, 0])
        record = StepRecord(TARGET, np.zeros(size), np.zeros(size), reached, StepStatus.FELL if fell else StepStatus.OK)
        steps.append(LoggedStep(0, number, TARGET, TARGET, np.zeros(size), record))
    return Steps(SPACE, steps)


def test_every_executed_hop_is_counted() -> None:
    assert executed_steps_to_band([log_of(1, [0.0] * 30)], BAND) == WINDOW
    assert executed_steps_to_band([log_of(-4, [0.5] * 5 + [0.0] * 30)], BAND) == 5 + WINDOW, (
        "errors of exploration are none"
    )
    assert executed_steps_to_band([log_of(1, [0.5] * 3, falls=True), log_of(1, [0.0] * 30)], BAND) == 3 + WINDOW
    assert executed_steps_to_band([log_of(1, [0.0] * 30), log_of(1, [0.0] * 30)], BAND) == WINDOW


@pytest.mark.parametrize("errors", [[0.5] * 40, [0.0] * (WINDOW - 1), [0.0] * 40 + [0.5]])
def test_an_error_that_does_not_stay_in_the_band_has_no_hops(errors: list[float]) -> None:
    assert executed_steps_to_band([log_of(1, errors)], BAND) is None


def test_the_band_is_reached_when_no_later_window_leaves_it() -> None:
    errors = np.zeros((60, 2))
    assert steps_to_band(errors, BAND) == 20
    errors[:10] = 10 * BAND
    assert steps_to_band(errors, BAND) == 30, "the last bad step must have left the window"
    errors[45] = 10 * BAND
    assert steps_to_band(errors, BAND) is None, "the last window is not in the band"
    errors[45] = [0.0, 4 * BAND[1]]  # 4 bands once in 20 are 0.9 bands on average
    assert steps_to_band(errors, BAND) == 30
    assert steps_to_band(np.zeros((19, 2)), BAND) is None
