from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reference import Reference, parse_reference, read_reference
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.parameters import CommandBounds

SPACE = CommandBounds().space()


def test_steady_and_transient_cover_all_from_the_first_change_on_once():
    reference = paper_reference()
    both = np.concatenate([reference.steady, reference.transient])
    assert sorted(both) == list(range(19, 227))


def test_transients_of_changes_closer_than_four_steps_count_each_step_once():
    reference = Reference.from_segments(("x",), [(1, [0]), (3, [1]), (5, [2])], 10)
    assert list(reference.transient) == [2, 3, 4, 5, 6, 7]
    assert list(reference.steady) == [8, 9]


def test_constant_reference_has_neither():
    reference = Reference.from_segments(("x",), [(1, [0.5])], 10)
    assert len(reference) == 10
    assert len(reference.changes) == len(reference.transient) == len(reference.steady) == 0


def test_targets_are_copied_and_cannot_be_written():
    source = np.zeros((3, 2))
    reference = Reference(("a", "b"), source)
    source[0, 0] = 1
    assert reference.targets[0, 0] == 0
    with pytest.raises(ValueError, match="read-only"):
        reference.targets[0, 0] = 1


@pytest.mark.parametrize(
    ("segments", "message"),
    [
        ([], "first must start at step 1"),
        ([(2, [0.0])], "first must start at step 1"),
        ([(1, [0.0]), (1, [1.0])], "must increase"),
        ([(1, [0.0]), (6, [1.0])], "not exceed 5 steps"),
    ],
)
def test_bad_segments_are_refused(segments, message):
    with pytest.raises(ValueError, match=message):
        Reference.from_segments(("x",), segments, 5)


@pytest.mark.parametrize("targets", [np.zeros(4), np.zeros((4, 3)), np.zeros((0, 2))])
def test_wrong_shape_is_refused(targets):
    with pytest.raises(ValueError, match=r"it must be \(steps, 2\)"):
        Reference(("speed", "height"), targets)


def test_target_that_is_not_finite_is_named():
    with pytest.raises(ValueError, match="height at step 2 must be a finite number"):
        Reference(("speed", "height"), np.array([[0, 0.5], [0, np.nan]]))


def test_reference_for_another_space_is_refused():
    with pytest.raises(ValueError, match="reference is for height,speed, the map for speed,height"):
        Reference(("height", "speed"), np.zeros((1, 2))).check(SPACE)


def test_csv_returns_what_was_written(tmp_path: Path):
    reference = paper_reference()
    path = tmp_path / "reference.csv"
    np.savetxt(path, reference.targets, delimiter=",", header="speed,height", comments="", fmt="%.17g")
    assert np.array_equal(read_reference(path, SPACE).targets, reference.targets)


def test_csv_columns_come_in_any_order_with_blanks_and_a_byte_order_mark(tmp_path: Path):
    path = tmp_path / "reference.csv"
    path.write_bytes("\ufeffheight, speed\r\n0.55, 0\r\n\r\n0.6,0.2\r\n".encode())
    reference = read_reference(path, SPACE)
    assert reference.names == ("speed", "height")
    assert reference.targets.tolist() == [[0, 0.55], [0.2, 0.6]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "plan.csv, line 1: the header is ''; it must be 'speed,height'"),
        ("speed;height\n0;0.5\n", "plan.csv, line 1: the header is 'speed;height'; it must be .* separated by commas"),
        ("speed,speed\n0,0.5\n", "plan.csv, line 1"),
        ("speed,height\n", "plan.csv, line 2: there is no step; it must have at least one row"),
        ("speed,height\n0,0.5\n0.1\n", "plan.csv, line 3: 1 values; it must have 2, one for each of speed,height"),
        ("speed,height\n0,0.5,7\n", "plan.csv, line 2: 3 values"),
        ("speed,height\n0,1\n\n0,high\n", "plan.csv, line 4, column 'height': 'high'; .* finite number in m, .* 0.58"),
        ("height,speed\n0.5,\n", "plan.csv, line 2, column 'speed': ''; it must be a finite number in m/s, .* 0.2"),
        ("speed,height\nnan,0.5\n", "plan.csv, line 2, column 'speed': 'nan'"),
        ("speed,height\n0,inf\n", "plan.csv, line 2, column 'height': 'inf'"),
    ],
)
def test_bad_csv_is_refused_with_line_and_remedy(text, message):
    with pytest.raises(ValueError, match=message):
        parse_reference(text, SPACE, "plan.csv")


def test_file_that_is_not_text_is_named(tmp_path: Path):
    path = tmp_path / "reference.csv"
    path.write_bytes(b"\xff\xfe\x00speed")
    with pytest.raises(ValueError, match=r"reference\.csv: this is not text"):
        read_reference(path, SPACE)
