from dataclasses import replace
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from stepgap.control import command_table
from stepgap.control.box_points import box_grid
from stepgap.control.command_table import CommandTable, build_table, measure_table
from stepgap.control.command_table_file import ARRAY_KINDS, read_table, write_table
from stepgap.control.step_controller import StepController
from stepgap.step import Array, StepFailed, StepStatus
from tests.control.maps import FoldedMap, LossyHopper, NeverWorks, RedundantMap, StumblingHopper

POINTS = 7


@pytest.fixture(scope="module")
def table() -> CommandTable:
    return build_table(LossyHopper(), POINTS)


@pytest.fixture(scope="module")
def worst_error(table: CommandTable) -> Array:
    return measure_table(table, LossyHopper(), np.random.default_rng(1), 500).worst_state


def state_at(fractions: Array) -> Array:
    """State at fractions of the range of use; outside of it beyond 0 and 1."""
    return np.array([0.0, 0.52]) + np.array([0.4, 0.12]) * fractions


fractions = arrays(float, 2, elements=st.floats(0, 1))
anywhere = arrays(float, 2, elements=st.floats(-0.5, 1.5))
quick = settings(max_examples=60, deadline=None, derandomize=True)


def test_at_its_nodes_it_equals_the_controller(table):
    controller = StepController(LossyHopper())
    for fraction in np.random.default_rng(0).integers(0, POINTS, (60, 4)) / (POINTS - 1):
        state, target = state_at(fraction[:2]), state_at(fraction[2:])
        plan, solved = table(state, target), controller(state, target)
        assert plan.reached == solved.reached
        np.testing.assert_allclose(plan.predicted, solved.predicted, atol=1e-6)
        np.testing.assert_allclose(plan.command, solved.command, atol=1e-3)
        assert plan.distance == pytest.approx(solved.distance, abs=1e-5)


@quick
@given(state=fractions, target=fractions)
def test_between_nodes_it_is_off_by_no_more_than_measured(table, worst_error, state, target):
    plan = table(state_at(state), state_at(target))
    if plan.reached:
        off = np.abs(LossyHopper()(state_at(state), plan.command) - state_at(target))
        assert (off <= 1.5 * worst_error + 1e-9).all()


@quick
@given(state=anywhere, target=anywhere)
def test_commands_never_leave_their_bounds(table, state, target):
    plan = table(state_at(state), state_at(target), guess=[0.0, 0.0])
    assert (np.abs(plan.command) <= [15, 20]).all()
    assert np.isfinite(plan.predicted).all()
    inside = np.array([state, target])
    if (inside < -1e-6).any() or (inside > 1 + 1e-6).any():
        assert not plan.reached
        nearest = table(state_at(np.clip(state, 0, 1)), state_at(np.clip(target, 0, 1)))
        np.testing.assert_allclose(plan.command, nearest.command, atol=1e-9)


def test_the_error_falls_with_the_square_of_the_spacing():
    error = [
        measure_table(build_table(LossyHopper(), points), LossyHopper(), np.random.default_rng(2), 2000)
        for points in (5, 9)
    ]
    assert (error[1].worst_state <= error[0].worst_state / 2 + 1e-12).all()
    assert (error[1].median_state <= error[0].median_state / 3 + 1e-12).all()
    assert (error[1].median_state <= error[1].worst_state).all()
    assert 600 < error[1].samples < 2000
    assert (error[1].border_state >= error[1].worst_state).all(), "commands have a kink at this border"
    assert 0 < error[1].border_samples < error[0].border_samples


def test_interpolation_of_many_equals_that_of_single_ones(table):
    states, targets = state_at(np.random.default_rng(3).uniform(0, 1, (2, 20, 2)))
    many = table.interpolate(states, targets)
    for i in range(20):
        plan = table(states[i], targets[i])
        np.testing.assert_array_equal(plan.command, many.command[i])
        assert plan.reached == many.reached[i]


def test_any_number_of_coordinates_and_commands():
    for step_map in (FoldedMap(), RedundantMap()):
        table = build_table(step_map, 4)
        middle = [(quantity.lower + quantity.upper) / 2 for quantity in step_map.space.state]
        assert len(table(middle, middle).command) == len(step_map.space.command)


def test_where_the_map_fails_the_table_fails():
    table = build_table(NeverWorks(), 2)
    with pytest.raises(StepFailed) as failure:
        table([0.2, 0.58], [0.2, 0.58])
    assert failure.value.status == StepStatus.FELL
    assert (table.statuses == StepStatus.FELL).all()
    with pytest.raises(ValueError, match="none of 100 random"):
        measure_table(table, NeverWorks(), np.random.default_rng(0), 100)


def test_nodes_with_unreachable_targets_are_marked():
    table = build_table(StumblingHopper(), 3)
    assert 0 < table.reached.mean() < 1
    assert (table.statuses == StepStatus.OK).all()
    distance = np.linalg.norm(table.predicted[0, 0] - state_at((box_grid(3, 2) + 1) / 2), axis=-1)
    np.testing.assert_array_equal(table.reached[0, 0], distance < 1e-6)


def test_progress_counts_every_node():
    calls = []
    build_table(LossyHopper(), 10, lambda done, total: calls.append((done, total)))
    assert calls[-1] == (10**4, 10**4)
    assert len(calls) > 1
    assert calls == sorted(calls)


def test_batches_make_no_difference(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = build_table(LossyHopper(), POINTS)
    for size in (1, 100):
        monkeypatch.setattr(command_table, "BATCH", size)
        found = build_table(LossyHopper(), POINTS)
        for name in ("commands", "predicted", "reached", "statuses"):
            np.testing.assert_array_equal(getattr(found, name), getattr(expected, name))


def test_bad_arguments_are_refused(table):
    with pytest.raises(ValueError, match="points = 1"):
        build_table(LossyHopper(), 1)
    with pytest.raises(ValueError, match="state has shape"):
        table([0.2], [0.2, 0.58])
    with pytest.raises(ValueError, match="finite"):
        table([0.2, 0.58], [0.2, np.nan])
    with pytest.raises(StepFailed):
        table([0.2, np.nan], [0.2, 0.58])
    with pytest.raises(ValueError, match="commands has shape"):
        replace(table, commands=table.commands[..., :1])
    with pytest.raises(ValueError, match="within their bounds"):
        replace(table, commands=table.commands * 3)
    with pytest.raises(ValueError, match="axes of equally many points"):
        replace(table, reached=table.reached[:-1])


# Files


@pytest.fixture
def file(table: CommandTable, tmp_path: Path) -> Path:
    write_table(tmp_path / "table.npz", table)
    return tmp_path / "table.npz"


def test_a_file_contains_all_of_a_table(table, file):
    again = read_table(file)
    assert again.space == replace(table.space, context=())
    for name in ("commands", "predicted", "reached", "statuses"):
        np.testing.assert_array_equal(getattr(again, name), getattr(table, name))
    assert again([0.2, 0.58], [0.25, 0.6]).command.tolist() == table([0.2, 0.58], [0.25, 0.6]).command.tolist()


def test_the_same_table_is_the_same_file_at_any_time(file):
    with ZipFile(file) as archive:
        assert {member.date_time for member in archive.infolist()} == {(1980, 1, 1, 0, 0, 0)}


def contents(file: Path) -> dict[str, np.ndarray]:
    with np.load(file) as members:
        return {name: members[name] for name in members.files}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"schema": np.array(2)}, "its schema is 2, but this version reads 1"),
        ({"commands": np.array([1.0])}, "commands has shape"),
        ({"commands": np.array([object()])}, "allow_pickle"),
        ({"commands": np.array(["a"])}, "commands has entries of type"),
        ({"ranges": np.full((4, 2), np.nan)}, r"lower = nan, but it must be finite \(speed\)"),
        ({"ranges": np.zeros((3, 2))}, "units and ranges"),
        ({"reached": np.zeros((3, 3), bool)}, "the grid has shape"),
        ({"statuses": np.full((POINTS,) * 4, 99)}, "statuses must be values of StepStatus"),
        ({"more": np.zeros(1)}, "more"),
    ],
)
def test_a_file_that_is_not_a_table_is_refused(file, change, message):
    np.savez(file, **(contents(file) | change))  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match=message) as failure:
        read_table(file)
    assert str(failure.value).startswith(f"{file}: ")
    assert "\n" not in str(failure.value)


def test_a_number_that_is_not_finite_is_refused(file):
    arrays_ = contents(file)
    arrays_["commands"][0, 0, 0, 0, 0] = np.nan
    np.savez(file, **arrays_)  # pyright: ignore[reportArgumentType]
    with pytest.raises(ValueError, match="finite"):
        read_table(file)


@pytest.mark.parametrize("content", [b"", b"speed,height\n", b"PK\x03\x04 cut off"])
def test_other_files_are_refused(tmp_path, content):
    (tmp_path / "rubbish.npz").write_bytes(content)
    with pytest.raises(ValueError, match=r"rubbish\.npz: .*command table"):
        read_table(tmp_path / "rubbish.npz")


def test_a_truncated_file_is_refused(file):
    whole = file.read_bytes()
    for length in range(0, len(whole), len(whole) // 20):
        file.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="command table"):
            read_table(file)
    assert set(ARRAY_KINDS) >= {"commands", "reached"}
