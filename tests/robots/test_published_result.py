"""A published result: its band, its errors, and whether a run tracks its reference."""

import numpy as np
import pytest

from stepgap.control.reference import Reference
from stepgap.robots.published_result import PublishedResult

REFERENCE = Reference(("height",), np.array([[0.5], [0.6], [0.7]]))
ERRORS = {0: {"rmse": np.array([0.03])}, 1: {"mae": np.array([0.02])}, 2: {"rmse": np.array([0.01])}}
RESULT = PublishedResult("the thesis", "its Tab. 3", REFERENCE, ERRORS)


def test_errors_by_deployment() -> None:
    assert RESULT.last == 2
    np.testing.assert_array_equal(RESULT.band, [0.01])
    assert RESULT.error("mae", 1, 0) == 0.02
    assert RESULT.error("rmse", 1, 0) is None
    assert RESULT.error("rmse", 3, 0) is None


@pytest.mark.parametrize("without", [0, 2])
def test_the_first_and_the_last_deployment_have_an_rmse(without: int) -> None:
    with pytest.raises(ValueError, match=f"no rmse of deployment {without}; the first and the last need one"):
        PublishedResult("the thesis", "its Tab. 3", REFERENCE, {**ERRORS, without: {}})


@pytest.mark.parametrize(
    ("rows", "complete", "tracked"), [(3, True, True), (2, True, False), (2, False, True), (0, False, True)]
)
def test_a_part_of_the_reference_is_tracked_by_a_deployment_that_was_cut_short(
    rows: int, complete: bool, tracked: bool
) -> None:
    assert RESULT.is_tracked_by(REFERENCE.targets[:rows], complete) == tracked


def test_other_targets_are_not_the_reference() -> None:
    assert not RESULT.is_tracked_by(REFERENCE.targets + 0.1, False)
    assert not RESULT.is_tracked_by(np.vstack([REFERENCE.targets, [[0.5]]]), False)
