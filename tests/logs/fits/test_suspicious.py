"""A few wrong rows are named and do not decide what `fit` says; what is rare, or lasts, is not wrong."""

import numpy as np
import pytest

from stepgap.learning.observations import Observations
from stepgap.learning.steps import Steps
from stepgap.logs.columns import Columns
from stepgap.logs.fits.fit import Comparison, FitData, compare
from stepgap.logs.fits.fit_results import describe_suspicious, gain_sentence, verdict
from stepgap.logs.fits.suspicious import far_rows, large_and_alone
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


def found(fitted: FitData, tested: FitData | None = None) -> Comparison:
    return compare(("none", "constant", "linear"), fitted, tested, None)


CLEAN = found(data(log()))


def gain(comparison: Comparison) -> Reduction:
    return comparison.validation.best.gain


def test_nothing_is_suspicious_in_a_clean_log() -> None:
    assert not CLEAN.suspicious
    assert CLEAN.with_them is CLEAN.validation
    assert len(verdict(CLEAN).splitlines()) == 1


@pytest.mark.parametrize("part", ["state", "command", "after", "predicted"])
@pytest.mark.parametrize("value", [1e5, -4.0])
def test_a_wrong_row_is_named_and_changes_nothing(part: str, value: float) -> None:
    arrays = log()
    arrays[part][17] = value
    one = found(data(arrays))
    assert list(one.suspicious) == ["line 19"]
    assert abs(gain(one).value - gain(CLEAN).value) < gain(CLEAN).half_width
    without, with_them = verdict(one).splitlines()
    assert without.startswith("best: ")
    assert with_them.startswith("with the suspicious rows: ")
    assert one.with_them.best.gain != one.validation.best.gain
    assert one.data.observed.space.state[0].upper < 1.1
    assert describe_suspicious(one.suspicious).startswith("suspicious  1 row, left out below: line 19 (")


def test_a_wrong_error_that_is_not_far_is_found_after_the_far_ones() -> None:
    arrays = log()
    arrays["state"][5], arrays["after"][30] = 1e5, arrays["after"][30] + 0.4  # within the range of the others
    one = found(data(arrays))
    assert list(one.suspicious) == ["line 7", "line 32"]
    assert "times a typical one" in one.suspicious["line 32"]
    tested = found(data(log(1)), data(arrays))
    assert list(tested.suspicious) == ["line 7", "line 32"]
    assert tested.tested is not None
    assert (len(tested.tested.steps), len(tested.data.steps)) == (COUNT - 2, COUNT)


def test_what_lasts_or_is_rare_or_is_large_everywhere_is_not_wrong() -> None:
    lasting, rare, everywhere, small = log(), log(), log(), log()
    lasting["after"][20:30] += 0.8
    lasting["state"] = np.append(
        lasting["state"][:1], lasting["after"][:-1], axis=0
    )  # each step begins where one ended
    lasting["predicted"] = lasting["after"] - 0.3 - 0.8 * (np.arange(COUNT) // 10 == 2)[:, None]
    assert not found(data(lasting)).suspicious
    rare["command"][:] = 0.5
    rare["command"][::20] = 1.0
    assert not far_rows(data(rare).steps)
    everywhere["state"][::5] = 50.0
    assert not far_rows(data(everywhere).steps)
    small["command"][:] = 0.0
    assert not far_rows(data(small).steps)


def test_large_errors_that_last_are_not_alone() -> None:
    ratios = np.zeros((6, 2))
    ratios[[1, 3, 4], 0] = 9.0
    follows, points = np.array([False, True, True, True, True, True]), 0.3 * np.arange(6.0)[:, None]
    assert large_and_alone(ratios, follows, points).tolist() == [False, True, False, False, False, False]
    apart = np.array([False, True, True, True, False, True])
    assert large_and_alone(ratios, apart, points).tolist() == [False, True, False, True, True, False]
    ratios[4, 0] = -9.0
    assert large_and_alone(ratios, follows, points).tolist() == [False, True, False, True, True, False]
    assert not large_and_alone(ratios / 2, follows, points).any()


def test_large_errors_that_return_at_similar_steps_are_not_alone() -> None:
    """If two of three similar steps deviate in the same direction, neither is alone."""
    ratios, follows = np.zeros((9, 2)), np.full(9, fill_value=True)
    points = np.repeat([[0.0, 0.0], [0.5, 0.0], [0.0, 0.5]], 3, axis=0) + 0.01 * np.arange(9.0)[:, None]
    ratios[[0, 2], 0] = 9.0
    ratios[[3, 5], 1] = 9.0, -9.0
    ratios[7, 0] = 9.0
    expected = [False, False, False, True, False, True, False, True, False]
    assert large_and_alone(ratios, follows, points).tolist() == expected


def test_percentages_have_bounds() -> None:
    assert gain_sentence(Reduction(-3.5e15, 1e3, 10)) == "far worse than without a correction"
    wide = gain_sentence(Reduction(-3.5e15, 3e15, 10))
    assert wide == "no difference shown from the error without a correction (within more than ± 1000 %)"
    assert gain_sentence(Reduction(-0.5, 0.1, 10)) == "50 ± 23 % more error than without a correction"
