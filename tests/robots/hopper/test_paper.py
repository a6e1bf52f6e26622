"""The paper's numbers are of the hopper that the package simulates, and agree with each other."""

import numpy as np

from stepgap.robots.hopper import paper
from stepgap.robots.hopper.parameters import CommandBounds

SPACE = CommandBounds().space()


def test_paper_reference_is_the_profile_of_fig_4() -> None:
    reference = paper.paper_reference()
    assert reference.names == ("speed", "height")
    assert reference.targets.shape == (227, 2)
    assert reference.of(SPACE) is reference
    for step, target in {1: (0, 0.55), 19: (0, 0.55), 20: (0.17, 0.58), 78: (0.392, 0.58), 79: (0.17, 0.5963)}.items():
        assert tuple(reference.targets[step - 1]) == target
    for step, target in {150: (0.17, 0.6126), 151: (0.2255, 0.6126), 198: (0.392, 0.6126), 227: (0.281, 0.629)}.items():
        assert tuple(reference.targets[step - 1]) == target


def test_paper_reference_changes_eighteen_times() -> None:
    reference = paper.paper_reference()
    changes = [20, 31, 43, 55, 67, 79, 91, 103, 115, 127, 139, 151, 163, 175, 187, 199, 211, 223]
    assert list(reference.changes + 1) == changes
    assert len(reference.transient) == 4 * 18
    assert list(reference.transient[:5] + 1) == [20, 21, 22, 23, 31]
    assert list(reference.steady[:8] + 1) == [24, 25, 26, 27, 28, 29, 30, 35]


def test_paper_agrees_with_itself() -> None:
    for name in paper.STATE_NAMES:
        assert paper.MAE_BY_ITERATION[name][0] == paper.NO_GP["mae"][name]
        assert paper.MAE_BY_ITERATION[name][paper.LAST_ITERATION] == paper.WITH_GP["mae"][name]
        for table in (paper.NO_GP, paper.WITH_GP):
            assert table["rmse"][name] >= max(table["mae"][name], abs(table["bias"][name]))


def test_the_result_has_the_errors_that_the_paper_gives() -> None:
    result = paper.paper_result()
    assert result.error("mae", 2, 0) == paper.MAE_BY_ITERATION["speed"][2]
    assert result.error("rmse", 1, 0) is None
    assert result.error("mae", 5, 0) is None
    for iteration, table in ((0, paper.NO_GP), (4, paper.WITH_GP)):
        for measure, by_name in table.items():
            assert [result.error(measure, iteration, row) for row in range(2)] == list(by_name.values())
    assert result.last == 4
    np.testing.assert_array_equal(result.band, [paper.WITH_GP["rmse"]["speed"], paper.WITH_GP["rmse"]["height"]])
