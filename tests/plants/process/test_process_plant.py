"""A plant behind lines of JSON: every way in which its program can fail is a recorded step or a clear error."""

import json
import re
import socket
import sys
import time
from collections.abc import Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from threading import Thread

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from stepgap.plants.plant import Touchdown
from stepgap.plants.process.line_channel import LONGEST_LINE, Child, Connection
from stepgap.plants.process.messages import ProcessFault, check_ready, read_answer, read_start, read_touchdown
from stepgap.plants.process.process_plant import ProcessPlant, Timeouts
from stepgap.step import ContextQuantity, Quantity, StepSpace, StepStatus
from tests.control.maps import YAW

BALL = [sys.executable, str(Path(__file__).with_name("ball.py"))]
SPACE = StepSpace((Quantity("height", "m", 0.2, 1.0),), (Quantity("paddle", "m/s", -0.5, 1.0),), (YAW,))
PATIENT = Timeouts(ready=60, start=60, step=60, stop=60)
REQUESTED = np.array([0.5])


def plant_of(*arguments: object, timeouts: Timeouts = PATIENT) -> ProcessPlant:
    return ProcessPlant(partial(Child, [*BALL, *map(str, arguments)]), SPACE, timeouts)


def next_height(height: float, paddle: float) -> float:
    return (0.8 * np.sqrt(2 * 9.81 * height) + 1.8 * 0.9 * paddle) ** 2 / (2 * 9.81)


def test_steps_go_to_the_program_and_come_back(capfd: pytest.CaptureFixture[str]) -> None:
    with plant_of() as plant:
        height = plant.start()[0]
        for command in (0.1, 0.3, 5.0):
            record = plant.take_step(np.array([command]))
            assert record.state == height
            assert record.requested == record.applied == min(command, 1.0)
            assert record.next_state == pytest.approx([next_height(height, min(command, 1.0))])
            assert (record.status, plant.fault) == (StepStatus.OK, "")
            height = record.next_state[0]
    assert capfd.readouterr().err == "at rest\n"
    plant.stop()


def test_an_answer_may_have_the_applied_command_and_the_context() -> None:
    with plant_of("applied", 1) as plant:
        plant.start()
        record = plant.take_step(REQUESTED)
    assert (record.applied, record.context) == ([0.25], {"yaw": 1.5})


def test_a_fall_is_recorded_without_a_fault() -> None:
    with plant_of("fell", 2) as plant:
        plant.start()
        records = [plant.take_step(REQUESTED) for _ in range(2)]
    assert [record.status for record in records] == [StepStatus.OK, StepStatus.FELL]
    assert np.isnan(records[1].next_state).all()
    assert plant.fault == ""


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("exit", "the program ended with code 3"),
        ("kill", "the program was ended by signal 9"),
        ("close", "the program closed its input or output"),
        ("long", f"by a line of more than {LONGEST_LINE} bytes"),
        ("hello", "'hello': the answer must be one JSON object per line"),
        ("[1]", "must be a JSON object"),
        ("{'step': 2}", '"status" must be one of ok, fell'),
        ("{'step': 7, 'status': 'ok'}", "step 2 was answered by"),
        ("{'step': 2, 'status': 'ok', 'next': {'speed': 1}}", '"next" must contain height, and nothing else'),
        ("{'step': 2, 'status': 'ok', 'next': {'height': NaN}}", "NaN is not a JSON number"),
        ("{'step': 2, 'status': 'ok', 'next': {'height': 1e999}}", "next.height must be a number within ±1e+09"),
        ("{'step': 2, 'status': 'ok', 'next': {'height': true}}", "next.height must be a number"),
    ],
)
def test_what_a_program_does_wrong_is_no_step_and_no_fall(fault: str, message: str) -> None:
    with plant_of(fault, 2, timeouts=Timeouts(60, 60, 60, stop=0.2)) as plant:
        plant.start()
        assert plant.take_step(REQUESTED).status == StepStatus.OK
        with pytest.raises(ProcessFault) as failed:
            plant.take_step(REQUESTED)
        assert message in str(failed.value)
        assert re.fullmatch("step 2: .*; its program failed, which is no fall of the robot", str(failed.value))
        with pytest.raises(ProcessFault, match="is not running"):
            plant.take_step(REQUESTED)


def test_an_error_that_a_program_reports_ends_the_deployment_with_the_reason() -> None:
    with plant_of("{'error': 'motor 2 is hot'}", 2, timeouts=Timeouts(60, 60, 60, stop=0.2)) as plant:
        plant.start()
        assert plant.take_step(REQUESTED).status == StepStatus.OK
        record = plant.take_step(REQUESTED)
    assert record.status == StepStatus.STOPPED
    assert np.isnan(record.next_state).all()
    assert plant.fault == "the program reports: 'motor 2 is hot'"


def test_a_program_that_stalls_is_ended() -> None:
    with plant_of("stall", 1, timeouts=Timeouts(60, 60, step=0.5, stop=0.2)) as plant:
        plant.start()
        with pytest.raises(ProcessFault, match=r"^step 1: the program did not answer within 0\.5 s"):
            plant.take_step(REQUESTED)
        assert plant._channel is None


def test_a_second_answer_is_noticed_before_or_with_the_next_step() -> None:
    with plant_of("twice", 1, timeouts=Timeouts(60, 60, 60, stop=0.2)) as plant:
        plant.start()
        assert plant.take_step(REQUESTED).status == StepStatus.OK
        with pytest.raises(ProcessFault, match=r"second answer|step 2 was answered by"):
            plant.take_step(REQUESTED)


def test_a_flood_of_answers_is_not_kept() -> None:
    with plant_of("flood", 1, timeouts=Timeouts(60, 60, 60, stop=0.2)) as plant:
        plant.start()
        plant.take_step(REQUESTED)
        time.sleep(0.2)
        with pytest.raises(ProcessFault, match="second answer"):
            plant.take_step(REQUESTED)
        assert plant._channel is None


def test_the_children_of_a_program_are_ended_with_it() -> None:
    script = f"{sys.executable} {BALL[1]} stall 1; true"
    plant = ProcessPlant(partial(Child, ["sh", "-c", script]), SPACE, Timeouts(60, 60, step=0.3, stop=0.3))
    plant.start()
    channel = plant._channel
    with pytest.raises(ProcessFault, match="did not answer"):
        plant.take_step(REQUESTED)
    assert channel is not None
    assert not channel._thread.is_alive(), "nobody holds its output open"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("units", 0), r"the program has the state .*'height': 'mm'.*, but the experiment needs height \[m\]"),
        (("start", 0), "NaN is not a JSON number"),
    ],
)
def test_a_program_for_another_robot_does_not_start(arguments: Sequence[object], message: str) -> None:
    with pytest.raises(ProcessFault, match=message), plant_of(*arguments) as plant:
        plant.start()


def test_a_program_that_does_not_exist_is_named() -> None:
    with pytest.raises(ProcessFault, match=r"\./none: cannot be started: No such file"):
        ProcessPlant(partial(Child, ["./none"]), SPACE).start()


def test_a_command_without_number_is_not_sent() -> None:
    with plant_of() as plant:
        plant.start()
        assert plant.take_step(np.array([np.nan])).status == StepStatus.INVALID


def test_over_a_socket() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:

        def serve() -> None:
            connection, _ = server.accept()
            with connection, connection.makefile("rw", encoding="utf-8") as stream:
                for reply in (
                    '{"ready": {"state": {"height": "m"}, "command": {"paddle": "m/s"}}}',
                    '{"state": {"height": 0.4}}',
                    '{"step": 1, "next": {"height": 0.6}, "status": "ok"}',
                ):
                    stream.readline()
                    stream.write(reply + "\n")
                    stream.flush()
                stream.readline()

        thread = Thread(target=serve)
        thread.start()
        with ProcessPlant(partial(Connection, server.getsockname()[1]), SPACE, PATIENT) as plant:
            assert plant.start() == [0.4]
            assert plant.take_step(REQUESTED).next_state == [0.6]
            with pytest.raises(ProcessFault, match="closed the connection"):
                plant.take_step(REQUESTED)
        thread.join()


def test_without_a_server_the_port_is_named() -> None:
    with closing(socket.create_server(("127.0.0.1", 0))) as server:
        port = server.getsockname()[1]
    with pytest.raises(ProcessFault, match=rf"127.0.0.1:{port}: .*; start the robot's program first"):
        ProcessPlant(partial(Connection, port), SPACE).start()


@given(st.text() | st.binary().map(lambda raw: raw.decode(errors="replace")))
def test_any_line_is_read_or_refused(line: str) -> None:
    for read in (
        lambda: check_ready(line, SPACE),
        lambda: read_start(line, SPACE),
        lambda: read_answer(line, 1, REQUESTED, SPACE),
    ):
        with pytest.raises(ProcessFault) as refused:
            read()
        assert len(str(refused.value)) < 600


NUMBERS = st.none() | st.booleans() | st.integers() | st.floats() | st.text()
TABLES = st.dictionaries(st.sampled_from(["height", "paddle", "x"]), NUMBERS) | NUMBERS


@given(
    st.fixed_dictionaries(
        {"step": st.sampled_from([1, 2, True, "1"]), "status": st.sampled_from(["ok", "fell", 0, None])},
        optional={"next": TABLES, "applied": TABLES, "yaw": NUMBERS},
    )
)
def test_an_answer_is_finite_or_refused(content: dict[str, object]) -> None:
    try:
        answer = read_answer(json.dumps(content), 1, REQUESTED, SPACE)
    except ProcessFault:
        return
    assert np.isfinite(answer.applied).all()
    assert np.isfinite(answer.next_state).all() == (answer.status == StepStatus.OK)
    assert np.isfinite(list(answer.context.values())).all()


def test_stopping_waits_for_the_robot_to_come_to_rest() -> None:
    """The program is ended by force only after the time that it is given."""
    plant = plant_of("deaf", 1, timeouts=Timeouts(60, 60, 60, stop=30))
    plant.start()
    plant.take_step(REQUESTED)
    begin = time.monotonic()
    plant.stop()
    assert time.monotonic() - begin < 25, "a program that ended by itself is not waited for"


@pytest.mark.parametrize("name", ["ready", "start", "step", "stop"])
def test_times_are_positive(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} = 0, but it must be a positive number of seconds"):
        Timeouts(**{name: 0})


FLOOR = StepSpace(
    (Quantity("height", "m", 0.2, 1.0, above="floor"),),
    (Quantity("paddle", "m/s", -0.5, 1.0),),
    (ContextQuantity("floor", "m"),),
)


@pytest.mark.parametrize("late", [False, True])
def test_a_touchdown_is_answered_by_the_command_that_acts(late: bool) -> None:
    """States are those above the floor that the step has found; a command that came too late is not recorded."""
    program = [sys.executable, str(Path(__file__).with_name("floor.py")), *["late"] * late]
    found = []

    def plan(touchdown: Touchdown) -> np.ndarray:
        found.append((touchdown.state[0], touchdown.context["floor"]))
        return np.array([0.7])

    with ProcessPlant(partial(Child, program), FLOOR, PATIENT) as plant:
        plant.start()
        records = [plant.take_replanned_step(REQUESTED, plan) for _ in range(2)]
        alone = plant.take_step(REQUESTED)
    acted = 0.5 if late else 0.7
    first = 0.6 * 0.4 + 0.2 * acted
    np.testing.assert_allclose(found, [(0.4, 0.1), (first + 0.1 + 0.05, -0.05)])
    for record, state in zip(records, (0.4, first + 0.15), strict=True):
        assert (record.command, record.requested, record.applied) == ([acted],) * 3
        assert record.state == pytest.approx([state])
        assert record.next_state == pytest.approx([0.6 * state + 0.2 * acted])
    assert (alone.requested, alone.context) == ([0.5], {"floor": 0.0})


def test_a_command_of_a_touchdown_that_is_no_number_leaves_the_first_one() -> None:
    program = [sys.executable, str(Path(__file__).with_name("floor.py"))]
    with ProcessPlant(partial(Child, program), FLOOR, PATIENT) as plant:
        plant.start()
        record = plant.take_replanned_step(REQUESTED, lambda found: np.array([np.nan]))
        assert (record.status, record.requested) == (StepStatus.OK, REQUESTED)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            '{"step": 1, "next": {"height": 0.5}, "status": "ok"}',
            'must contain "floor", above which a state is',
        ),
        ('{"step": 1, "touchdown": {"flor": 0.1}}', 'must contain "floor", above which a state is'),
        (
            '{"step": 1, "next": {"height": 0.5}, "status": "ok", "floor": 0.1, "requested": {"paddle": 2}}',
            "requested.paddle must lie within its bounds",
        ),
    ],
)
def test_an_answer_without_what_states_are_measured_above_is_refused(line: str, message: str) -> None:
    def read() -> object:
        found = read_touchdown(line, 1, FLOOR)
        return read_answer(line, 1, REQUESTED, FLOOR) if found is None else found

    with pytest.raises(ProcessFault, match=message):
        read()


def test_a_failed_step_has_its_state_above_the_floor_that_it_found() -> None:
    program = [sys.executable, str(Path(__file__).with_name("floor.py")), "breaks"]
    with ProcessPlant(partial(Child, program), FLOOR, PATIENT) as plant:
        plant.start()
        record = plant.take_replanned_step(REQUESTED, lambda found: REQUESTED)
        assert record.status == StepStatus.STOPPED
        assert record.state == pytest.approx([0.4])
