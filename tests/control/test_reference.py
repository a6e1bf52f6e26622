from pathlib import Path

import numpy as np
import pytest

from stepgap.control.reference import Reference, parse_reference, read_reference, reference_text
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.parameters import CommandBounds
from tests.control.maps import PitchingHopper

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


def test_the_mean_target_is_that_after_the_start_of_the_targets_that_there_are() -> None:
    targets = [[0.1, np.nan, 0.0], [0.1, np.nan, 0.0], [0.2, np.nan, np.nan], [0.4, np.nan, 0.6]]
    np.testing.assert_allclose(Reference(("a", "b", "c"), np.array(targets)).mean_target, [0.3, np.nan, 0.6])
    np.testing.assert_allclose(Reference(("a",), np.full((5, 1), 0.3)).mean_target, [0.3])


@pytest.mark.parametrize("targets", [np.zeros(4), np.zeros((4, 3)), np.zeros((0, 2))])
def test_wrong_shape_is_refused(targets):
    with pytest.raises(ValueError, match=r"it must be \(steps, 2\)"):
        Reference(("speed", "height"), targets)


def test_an_infinite_target_is_named_and_some_target_is_needed():
    with pytest.raises(ValueError, match="height at step 2 must be a finite number, or NaN for none"):
        Reference(("speed", "height"), np.array([[0, 0.5], [0, np.inf]]))
    with pytest.raises(ValueError, match="there is no target"):
        Reference(("speed", "height"), np.full((2, 2), np.nan))


def test_a_reference_of_some_coordinates_in_any_order_is_that_of_a_space():
    some = Reference(("height",), np.array([[0.5], [0.6]])).of(SPACE)
    assert some.names == ("speed", "height")
    np.testing.assert_array_equal(some.targets, [[np.nan, 0.5], [np.nan, 0.6]])
    turned = Reference(("height", "speed"), np.array([[0.5, 0.1]])).of(SPACE)
    assert turned.targets.tolist() == [[0.1, 0.5]]
    empty = Reference(("speed", "pitch"), np.array([[0.1, np.nan]])).of(SPACE)
    np.testing.assert_array_equal(empty.targets, [[0.1, np.nan]])


def test_targets_of_what_is_not_tracked_are_refused():
    with pytest.raises(ValueError, match="the reference has targets of pace; the robot tracks speed,height"):
        Reference(("pace", "height"), np.zeros((1, 2))).of(SPACE)
    robot = PitchingHopper().space
    with pytest.raises(ValueError, match="targets of pitch,pitch_rate; the robot tracks speed,height"):
        Reference(robot.state_names, np.zeros((1, 4))).of(robot)
    with pytest.raises(ValueError, match="the header is 'speed,pitch'; it must be 'speed,height', or some of them"):
        parse_reference("speed,pitch\n0,0\n", robot)


def test_steps_without_a_target_are_changes_like_others():
    none = np.nan
    reference = Reference(("x", "y"), np.array([[0, none], [0, none], [none, none], [none, none], [0, none], [0, 1.0]]))
    assert reference.changes.tolist() == [2, 4, 5]
    first, number = reference.distinct
    np.testing.assert_array_equal(reference.targets[first][number], reference.targets)
    assert len(first) == 3
    paper = paper_reference()
    first, number = paper.distinct
    distinct, expected = np.unique(paper.targets, axis=0, return_index=True)
    assert first.tolist() == expected.tolist()
    assert distinct[number].tolist() == paper.targets.tolist()


@pytest.mark.parametrize(
    ("text", "targets"),
    [
        ("height\n0.5\n0.6\n", [[np.nan, 0.5], [np.nan, 0.6]]),
        ("speed,height\n0.1,0.5\n,\n , \n", [[0.1, 0.5]]),
        ("speed,height\n0.1,\n ,0.6\n,\nnan,0.5\n", [[0.1, np.nan], [np.nan, 0.6], [np.nan, np.nan], [np.nan, 0.5]]),
        ("height\n0.5\nnan\nNaN\n0.6\n", [[np.nan, 0.5], [np.nan, np.nan], [np.nan, np.nan], [np.nan, 0.6]]),
    ],
)
def test_missing_columns_and_empty_cells_have_no_target_and_survive_writing(text: str, targets: list[list[float]]):
    for space in (SPACE, PitchingHopper().space):
        reference = parse_reference(text, space)
        np.testing.assert_array_equal(reference.targets[:, :2], targets)
        assert np.isnan(reference.targets[:, 2:]).all()
        again = parse_reference(reference_text(reference), space)
        np.testing.assert_array_equal(again.targets, reference.targets)


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


def test_a_table_of_a_spreadsheet_with_decimal_commas_is_read(tmp_path: Path):
    path = tmp_path / "plan.csv"
    path.write_bytes("\ufeffspeed;height\r\n0;0,55\r\n0,2;0.6\r\n;\r\n".encode())
    assert read_reference(path, SPACE).targets.tolist() == [[0, 0.55], [0.2, 0.6]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "plan.csv, line 1: the header is ''; it must be 'speed,height'"),
        ("speed\theight\n0\t0.5\n", r"plan.csv, line 1: the header is 'speed\\theight'; .* separated by commas"),
        ("speed;height\n0;0,5;7\n", "plan.csv, line 2: 3 values"),
        ("speed,speed\n0,0.5\n", "plan.csv, line 1"),
        ("speed,height\n", "plan.csv, line 2: there is no step; it must have at least one row"),
        ("speed,height\n0,0.5\n0.1\n", "plan.csv, line 3: 1 values; it must have 2, one for each of speed,height"),
        ("speed,height\n0,0.5,7\n", "plan.csv, line 2: 3 values"),
        ("speed,height\n0,1\n\n0,high\n", "plan.csv, line 4, column 'height': 'high'; .* finite number in m, .* 0.58"),
        ("height,speed\n0.5,-\n", "plan.csv, line 2, column 'speed': '-'; it must be a finite number in m/s, .* 0.2"),
        ("speed,height\n,\n,nan\n", "plan.csv: there is no target; it must have a number in at least one row"),
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
