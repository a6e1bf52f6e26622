"""A few wrong rows are named and do not decide what `fit` says; what is rare, or lasts, is not wrong."""

import numpy as np
import pytest

from stepgap.learning.observations import Observations
from stepgap.learning.steps import Steps
from stepgap.logs.columns import Columns
from stepgap.logs.fits.fit import FitData, compare, without_suspicious
from stepgap.logs.fits.fit_results import describe_suspicious, gain_sentence
from stepgap.logs.fits.validation import Reduction
from stepgap.records.model_files import NominalSource
from stepgap.step import Array

COLUMNS = Columns(state=("v",), next=("n",), command=("c",))
COUNT = 60


def log(seed: int = 0) -> dict[str, Array]:
    """Steps whose error is 0.3 + 0.2 c."""
    rng = np.random.default_rng(seed)
    state, command = rng.uniform(0, 1, (COUNT, 1)), rng.uniform(-1, 1, (COUNT, 1))
    predicted = 0.5 * state
    after = predicted + 0.3 + 0.2 * command + 0.02 * rng.normal(size=(COUNT, 1))
    return {"state": state, "command": command, "after": after, "predicted": predicted}


def data(arrays: dict[str, Array]) -> FitData:
    state, command, after, predicted = (arrays[name] for name in ("state", "command", "after", "predicted"))
    space = COLUMNS.space(state, command)
    steps = Steps.of_columns(space, state=state, command=command, next_state=after, predicted=predicted)
    origin = np.array([f"line {row + 2}" for row in range(COUNT)])
    observed, source = Observations(space, state, command, after - predicted), NominalSource("predicted")
    return FitData(steps, observed, origin, {}, "", source, COLUMNS)


def gain(data: FitData) -> Reduction:
    return compare(("none", "constant", "linear"), data, None, None).best.gain


CLEAN = data(log())


def test_nothing_is_suspicious_in_a_clean_log() -> None:
    kept, suspicious = without_suspicious(CLEAN)
    assert kept is CLEAN
    assert not suspicious


@pytest.mark.parametrize("part", ["state", "command", "after", "predicted"])
@pytest.mark.parametrize("value", [1e5, -4.0])
def test_a_wrong_row_is_named_and_changes_nothing(part: str, value: float) -> None:
    arrays = log()
    arrays[part][17] = value
    kept, suspicious = without_suspicious(data(arrays))
    assert list(suspicious) == ["line 19"]
    assert abs(gain(kept).value - gain(CLEAN).value) < gain(CLEAN).half_width
    assert kept.observed.space.state[0].upper < 1.1
    assert describe_suspicious(suspicious).startswith("suspicious  1 row, left out below: line 19 (")


def test_a_wrong_error_of_numbers_that_are_not_far_is_found() -> None:
    arrays = log()
    arrays["state"][5], arrays["after"][30] = 1e5, arrays["after"][30] + 0.9
    assert list(without_suspicious(data(arrays))[1]) == ["line 7", "line 32"]
    assert "error of v = 1." in without_suspicious(data(arrays))[1]["line 32"]


def test_what_lasts_or_is_rare_or_is_large_everywhere_is_not_wrong() -> None:
    lasting, rare, everywhere, small = log(), log(), log(), log()
    lasting["after"][20:30] += 0.8
    rare["command"][:] = 0.5
    rare["command"][::20] = 1.0
    everywhere["state"][::5] = 50.0
    small["command"][:] = 0.0
    for arrays in (lasting, rare, everywhere, small):
        assert not without_suspicious(data(arrays))[1]


def test_percentages_have_bounds() -> None:
    assert gain_sentence(Reduction(-3.5e15, 1e3, 10)) == "far worse than without a correction"
    wide = gain_sentence(Reduction(-3.5e15, 3e15, 10))
    assert wide == "no difference shown from the error without a correction (within more than ± 1000 %)"
    assert gain_sentence(Reduction(-0.5, 0.1, 10)) == "50 ± 23 % more error than without a correction"
