"""The step log: exact, strictly checked, on disk step by step, with one writer at a time."""

import hashlib
import math
import os
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.base.errors import InputError
from stepgap.learning.steps import LoggedStep, column_names
from stepgap.records import steps_csv
from stepgap.records.steps_csv import (
    RecordError,
    StepWriter,
    digest,
    ends_with_whole_row,
    read_step_log,
    row_of,
    space_of_header,
)
from stepgap.step import Quantity, StepRecord, StepSpace, StepStatus
from tests.control.maps import YAW
from tests.full_disk import FILE_TOO_LARGE, largest_file

SPACE = StepSpace(
    (Quantity("speed", "m/s", 0.0, 0.4), Quantity("height", "m", 0.5, 0.6)),
    (Quantity("fx", "N", -15, 15), Quantity("fy", "N", -20, 20)),
    (YAW,),
)
FINITE = st.floats(allow_nan=False, allow_infinity=False)
PAIR = st.tuples(FINITE, FINITE).map(np.array)
NO_STATE = np.full(2, np.nan)


def step(iteration: int = 0, number: int = 1, status: StepStatus = StepStatus.OK, offset: float = 0.0) -> LoggedStep:
    next_state = np.array([0.1 + 0.01 * number + offset, 0.55]) if status == StepStatus.OK else NO_STATE
    record = StepRecord(np.array([0.1, 0.55]), np.array([1.0, -2.0]), np.array([0.5, -2.0]), next_state, status)
    return LoggedStep(iteration, number, np.array([0.2, 0.58]), np.array([0.2, 0.58]), np.zeros(2), record)


def write(path: Path, *steps: LoggedStep) -> None:
    with StepWriter(path, SPACE) as writer:
        for logged in steps:
            writer.append(logged)


@st.composite
def any_step(draw: st.DrawFn) -> LoggedStep:
    status = draw(st.sampled_from(list(StepStatus)))
    next_state = draw(PAIR) if status == StepStatus.OK else NO_STATE
    predicted = draw(st.one_of(PAIR, st.just(NO_STATE)))
    yaw = draw(st.one_of(FINITE, st.just(math.nan)))
    true_state = draw(st.one_of(PAIR, st.just(NO_STATE)))
    applied = draw(PAIR if status == StepStatus.OK else st.one_of(PAIR, st.just(NO_STATE)))
    record = StepRecord(draw(PAIR), draw(PAIR), applied, next_state, status, {"yaw": yaw}, draw(PAIR), true_state)
    return LoggedStep(0, 1, draw(PAIR), predicted, draw(PAIR), record)


def numbers_of(logged: LoggedStep) -> bytes:
    record = logged.record
    commands = (record.command, record.requested, record.applied)
    arrays = (record.state, logged.target, *commands, record.next_state, record.true_next_state)
    return np.concatenate([*arrays, logged.predicted, logged.std, [record.context["yaw"]]]).tobytes()


@given(logged=any_step())
def test_a_step_is_read_back_exactly(tmp_path_factory: pytest.TempPathFactory, logged: LoggedStep) -> None:
    path = tmp_path_factory.mktemp("log") / "steps.csv"
    write(path, logged)
    (read,) = read_step_log(path, SPACE)
    assert (read.iteration, read.step, read.record.status) == (0, 1, logged.record.status)
    assert numbers_of(read) == numbers_of(logged)
    assert row_of(read, SPACE) == row_of(logged, SPACE)


def test_the_columns_are_the_contract(tmp_path: Path) -> None:
    write(tmp_path / "steps.csv", step(), step(number=2, status=StepStatus.FELL))
    header, *rows = (tmp_path / "steps.csv").read_text().splitlines()
    assert header == (
        "iteration,step,speed,height,target_speed,target_height,fx,fy,requested_fx,requested_fy,applied_fx,applied_fy,"
        "next_speed,next_height,true_next_speed,true_next_height,predicted_speed,predicted_height,std_speed,std_height,yaw_after,status"
    )
    assert header.split(",") == column_names(SPACE)
    assert rows[0] == "0,1,0.1,0.55,0.2,0.58,1.0,-2.0,1.0,-2.0,0.5,-2.0,0.11,0.55,nan,nan,0.2,0.58,0.0,0.0,nan,ok"
    assert rows[1] == "0,2,0.1,0.55,0.2,0.58,1.0,-2.0,1.0,-2.0,0.5,-2.0,nan,nan,nan,nan,0.2,0.58,0.0,0.0,nan,fell"


def test_an_infinite_context_is_refused() -> None:
    record = step().record
    with pytest.raises(ValueError, match=r"context\.yaw = inf, but it must be a finite number, or NaN where it is not"):
        replace(record, context={"yaw": math.inf})


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"state": NO_STATE}, "the state of the plant is not finite: nan, nan"),
        ({"requested": np.array([1.0, math.inf])}, "the requested command of the plant is not finite: 1.0, inf"),
        ({"applied": NO_STATE}, "the applied command of the plant is not finite: nan, nan"),
        ({"next_state": NO_STATE}, "the next state of the plant is not finite: nan, nan"),
        ({"next_state": np.zeros(3)}, "the next state of the plant has shape (3,) instead of (2,)"),
        ({"true_next_state": np.float64(0.5)}, "the true next state of the plant has shape () instead of (2,)"),
        ({"std": NO_STATE}, "the standard deviation of nominal map and residual is not finite: nan, nan"),
        (
            {"context": {"ground": 0.1}},
            "the robot does not declare the context ground of the plant, in StepSpace.context",
        ),
        ({"predicted": np.zeros(1)}, "the predicted state of nominal map and residual has shape (1,) instead of (2,)"),
    ],
)
def test_a_step_that_could_not_be_read_is_not_written(tmp_path: Path, wrong: dict, message: str) -> None:
    path, second = tmp_path / "steps.csv", step(number=2)
    if wrong.keys() <= {"std", "predicted"}:
        second = replace(second, **wrong)
    else:
        second = replace(second, record=replace(second.record, **wrong))
    with StepWriter(path, SPACE) as writer:
        writer.append(step())
        before = path.read_bytes()
        with pytest.raises(RecordError) as caught:
            writer.append(second)
    assert str(caught.value) == f"{path}: step 2 of deployment 0 cannot be recorded: {message}"
    assert path.read_bytes() == before


@pytest.mark.parametrize(
    ("state", "command", "message"),
    [
        (("step",), (), "the name 'step' of a coordinate is that of another column"),
        (("iteration",), (), "the name 'iteration'"),
        (("x",), ("status",), "the name 'status'"),
        (("x",), ("yaw_after",), "the name 'yaw_after'"),
        (("x", "place_after"), (), "the name 'place_after'"),
        (("x",), ("x",), "the name 'x'"),
        (("x", "next_x"), (), "the name 'next_x'"),
        ([f"x{number}" for number in range(101)], (), "the state has 101 coordinates, but it must have at most 100"),
    ],
)
def test_names_that_could_not_be_read_are_refused_before_the_first_step(
    tmp_path: Path, state: tuple[str, ...], command: tuple[str, ...], message: str
) -> None:
    coordinates = [tuple(Quantity(name, "", -1.0, 1.0) for name in names) for names in (state, command)]
    with pytest.raises(RecordError, match=message):
        StepWriter(tmp_path / "steps.csv", StepSpace(coordinates[0], coordinates[1], (YAW,)))
    assert not (tmp_path / "steps.csv").exists()


def test_each_row_is_on_disk_before_append_returns(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, on_disk = tmp_path / "steps.csv", []
    sync = os.fsync

    def watched(descriptor: int) -> None:
        sync(descriptor)
        on_disk.append(path.read_text().count("\n"))

    monkeypatch.setattr(steps_csv.os, "fsync", watched)
    with StepWriter(path, SPACE) as writer:
        for number in (1, 2, 3):
            writer.append(step(number=number))
            assert on_disk[-1] == number + 1
            assert len(read_step_log(path, SPACE)) == number


def test_a_file_cut_off_anywhere_is_continued_after_the_last_complete_row(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    write(path, step(), step(number=2))
    whole = path.read_bytes()
    header = whole.index(b"\n")
    for length in {0, 1, header - 1, header, header + 1, *range(header + 2, len(whole), 9), len(whole) - 1, len(whole)}:
        path.write_bytes(whole[:length])
        kept = max(0, whole[:length].count(b"\n") - 1)
        assert len(read_step_log(path, SPACE)) == kept
        with StepWriter(path, SPACE) as writer:
            assert len(writer.recorded) == kept
            assert path.read_bytes() == whole[:length], "opening changes nothing"
            for number in range(kept + 1, 3):
                writer.append(step(number=number))
        assert path.read_bytes() == whole or kept == 2


def test_the_error_of_a_full_disk_names_the_file_and_damages_no_row(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    write(path, step())
    whole = path.read_bytes()
    with largest_file(len(whole) + 20), pytest.raises(OSError, match=FILE_TOO_LARGE) as caught:
        write(path, step(number=2))
    assert caught.value.filename == str(path)
    assert path.read_bytes()[: len(whole)] == whole
    write(path, step(number=2))
    assert len(read_step_log(path, SPACE)) == 2


def test_the_digest_is_that_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    write(path, step(), step(number=2, status=StepStatus.NO_APEX))
    assert digest(read_step_log(path, SPACE)) == hashlib.sha256(path.read_bytes()).hexdigest()


@pytest.mark.parametrize(
    ("spoil", "line", "expected"),
    [
        (lambda text: text.replace("speed", "pace", 1), 1, "the columns must be iteration,step,speed"),
        (lambda text: text.replace("yaw_after", "place_after", 1), 1, "column yaw_after was called place_after"),
        (lambda text: text.replace("requested_", "", 2), 1, "older version of StepGap, without the columns requested_"),
        (lambda text: "hello", 1, "columns"),
        (lambda text: "\n" + text, 1, "columns"),
        (lambda text: text.replace("0.55", "0.5x", 1), 2, "could not convert"),
        (lambda text: text.replace("0.55", "nan", 1), 2, "not finite"),
        (lambda text: text.replace("0.12000000000000001", "inf"), 3, "not finite"),
        (lambda text: text.replace(",ok", ",fine", 1), 2, "unknown status 'fine'"),
        (lambda text: text.replace(",ok", ",ok,", 1), 2, "23 columns instead of 22"),
        (lambda text: text.replace("0,2,", "0,3,"), 3, "step 3 of deployment 0 where step 2 of deployment 0"),
        (lambda text: text.replace("0,2,", "0,1,"), 3, "step 1 of deployment 0"),
        (lambda text: text.replace("0,2,", "3,1,"), 3, "or step 1 of deployment 1"),
        (lambda text: text.replace("0,1,", "1,1,"), 2, "where step 1 of deployment 0 must be"),
        (lambda text: text.replace("0,1,", "0.0,1,"), 2, "invalid literal"),
        (lambda text: text + "\n", 4, "1 columns"),
        (lambda text: text.replace("0.55", "z" * 200_000, 1), 2, "could not convert"),
        (lambda text: text + "x" * 200_000 + "\n", 4, "1 columns"),
        (lambda text: text.replace("0.11,0.55", "nan,nan").replace("ok", "fell", 1), 3, "step 1 of deployment 1"),
    ],
)
def test_a_damaged_file_is_refused_by_line_and_not_changed(tmp_path: Path, spoil, line: int, expected: str) -> None:
    path = tmp_path / "steps.csv"
    write(path, step(), step(number=2))
    path.write_text(spoil(path.read_text()))
    before = path.read_bytes()
    with pytest.raises(RecordError) as caught:
        read_step_log(path, SPACE)
    message = str(caught.value)
    assert message.startswith(f"{path}, line {line}: ")
    assert expected in message
    assert len(message) < 500
    with pytest.raises(RecordError):
        StepWriter(path, SPACE)
    assert path.read_bytes() == before


def test_a_file_that_is_not_text_or_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "steps.csv"
    path.write_bytes(b"\xff\xfe\x00\n")
    with pytest.raises(RecordError, match=r"steps\.csv: not a text file in UTF-8"):
        read_step_log(path, SPACE)
    write(tmp_path / "large.csv", step())
    monkeypatch.setattr(steps_csv, "LARGEST_STEPS_FILE", 100)
    with pytest.raises(RecordError, match=r"large\.csv: larger than 100 bytes"):
        read_step_log(tmp_path / "large.csv", SPACE)
    with pytest.raises(FileNotFoundError):
        read_step_log(tmp_path / "none.csv", SPACE)


def test_a_fall_with_numbers_is_read_as_well(tmp_path: Path) -> None:
    """A safety stop in the same tick as the apex has a next state, but is a failure."""
    record = StepRecord(np.zeros(2), np.zeros(2), np.zeros(2), np.array([0.1, math.nan]), StepStatus.STOPPED)
    write(tmp_path / "steps.csv", LoggedStep(0, 1, np.zeros(2), np.zeros(2), np.zeros(2), record))
    assert read_step_log(tmp_path / "steps.csv", SPACE).failed_steps == 1


def test_one_writer_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    with StepWriter(path, SPACE) as first:
        first.append(step())
        with pytest.raises(RecordError, match=r"steps\.csv: another process is writing this run"):
            StepWriter(path, SPACE)
        first.append(step(number=2))
    write(path, step(number=3))
    assert len(read_step_log(path, SPACE)) == 3


def test_lines_may_end_as_on_windows(tmp_path: Path) -> None:
    path = tmp_path / "steps.csv"
    write(path, step())
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))
    assert len(read_step_log(path, SPACE)) == 1


@pytest.mark.parametrize("name", ["a b", "*/", "", "3"])
def test_a_header_with_a_name_that_is_no_identifier_is_refused(tmp_path: Path, name: str) -> None:
    path = tmp_path / "steps.csv"
    columns = column_names(SPACE)
    path.write_text(",".join(column.replace("speed", name) for column in columns) + "\n")
    with pytest.raises(ValueError, match="line 1: not the header of a step log"):
        space_of_header(path)
    path.write_text(",".join([*columns[:-1], f"{name}_after", "status"]) + "\n")
    with pytest.raises(RecordError, match="line 1: the columns must be"):
        read_step_log(path, SPACE)


def test_neither_a_pipe_nor_a_link_is_a_step_log(tmp_path: Path) -> None:
    """A reader would wait for the other end of a pipe, and a writer would change the file at the end of a link."""
    path = tmp_path / "steps.csv"
    os.mkfifo(path)
    with_space = (partial(reader, space=SPACE) for reader in (read_step_log, StepWriter))
    for read in (space_of_header, ends_with_whole_row, *with_space):
        with pytest.raises(InputError, match=r"steps\.csv: a pipe or a device, so it is not read"):
            read(path)
    path.unlink()
    path.symlink_to(tmp_path / "mine.csv")
    with pytest.raises(InputError, match=r"steps\.csv: a link, through which nothing is written"):
        StepWriter(path, SPACE)
    assert not (tmp_path / "mine.csv").exists()
