"""Two processes and a ring in a third, in lock-step: its time advances with frames, also on a busy machine."""

import os
import resource
import select
import signal
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from math import inf
from multiprocessing import get_context
from pathlib import Path
from time import sleep

import numpy as np
import pytest

from stepgap.hardware.hopper.ethercat import hopper_on_ethercat
from stepgap.hardware.realtime.board import Request
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.hardware.realtime.realtime_plant import RealtimePlant
from stepgap.hardware.realtime.session import FIRST_TICKS
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import read_description, read_ticks
from stepgap.rigs.rig import RigFault
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.step import StepStatus
from tests.hardware.ethercat.ring_process import RecordedTwin, live_ring
from tests.hardware.realtime.patience import patient
from tests.hardware.realtime.test_faults import LIMITS, SETTINGS, WATCHDOG

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")
pytestmark = pytest.mark.usefixtures("warm_realtime")

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
COMMAND = np.array([-4.0, -3.0])

SETUP = RealtimeSetup(
    partial(hopper_on_ethercat, SETTINGS, ROBOT),
    HopperControl(ROBOT, GAINS, BOUNDS),
    # on a busy machine a command may come late
    LoopSettings(calibrate_time=0.05, stand_time=0.15, landing_time=0.4, missed_commands=50, release_time=inf),
    patient,
)
COLUMN = {name: index for index, name in enumerate(SETUP.units)}


@contextmanager
def unattended(board):
    """Nobody needs to hold a key here."""
    yield


@contextmanager
def hopping(folder: Path):
    with live_ring(make_machine=RecordedTwin) as ring, RealtimePlant(SETUP, folder, unattended) as plant:
        plant.start()
        yield ring, plant


def logged(folder: Path, number=0):
    return read_ticks(folder / f"ticks-{number}.mcap")[1]


def check_off(ring):
    """No torque when no frame has come for the watchdog's time and 5 ms, and none ever after."""
    before = len(ring.look().torques)
    behind = ring.wait(round(WATCHDOG * 1000) + 5)
    assert behind.now == [0.0, 0.0]
    assert behind.enabled == [False, False]
    given = np.array(ring.wait(100).torques)
    assert np.abs(given).max() <= LIMITS.torque
    assert not given[before + round(WATCHDOG * 1000) + 4 :].any()
    return given


def test_it_hops_lands_and_keeps_every_tick(tmp_path):
    prompts, yaws = [], []

    @contextmanager
    def asked(board):
        prompts.append(board.state)
        yield

    with live_ring(make_machine=RecordedTwin) as ring:
        with RealtimePlant(SETUP, tmp_path, asked, "as in rig.toml") as plant:
            state = plant.start()
            assert prompts == [RigState.READY]
            for _ in range(2):
                record = plant.take_step(COMMAND)
                assert record.status == StepStatus.OK
                np.testing.assert_array_equal(record.state, state)
                np.testing.assert_array_equal(record.command, COMMAND)
                state = record.next_state
                assert 0.5 < state[1] < 0.7
                yaws.append(record.context["yaw"])
        assert plant.fault == ""
        check_off(ring)
        given = np.array(ring.look().torques)
    rows = logged(tmp_path)
    assert np.isin(yaws, rows[:, COLUMN["boom_horizontal"]] * 2 * np.pi / 5000).all()
    np.testing.assert_allclose(np.diff(rows[:, 0]), 1e-3)
    states = [RigState(state).name for state in dict.fromkeys(rows[:, COLUMN["state"]])]
    assert states == ["CALIBRATE", "READY", "STAND", "STEP", "STOP", "OFF"]
    description, events = read_description(tmp_path / "ticks-0.mcap")
    assert description.settings == "as in rig.toml"
    assert [event.text for event in events] == [FIRST_TICKS]
    assert events[0].time in rows[:, 0]
    applied = rows[:, COLUMN["applied_1"] : COLUMN["applied_2"] + 1]
    first = int(np.argmax(given.any(axis=1))), int(np.argmax(applied.any(axis=1)))
    count = len(applied) - first[1]
    np.testing.assert_allclose(given[first[0] :][:count], applied[first[1] :], atol=1e-9)


def test_after_a_killed_real_time_process_torque_is_off_and_no_logged_tick_is_lost(tmp_path):
    with hopping(tmp_path) as (ring, plant):
        assert plant.take_step(COMMAND).status == StepStatus.OK
        session = plant._session
        assert session is not None
        rows = session.board.ticks
        os.kill(session.process_id, signal.SIGKILL)
        record = plant.take_step(COMMAND)
        assert record.status == StepStatus.STOPPED
        assert np.isnan(record.next_state).all()
        assert plant.fault == "the real-time process was killed by signal 9"
        given = check_off(ring)
        assert np.abs(given[-2000:]).max() > 1, "it hopped when it was killed, the time of the watchdog before"
    assert len(logged(tmp_path)) >= rows - 1, "the tick that was under way is lost, no other"


def learn_and_die(setup: RealtimeSetup, folder: Path, pipe):
    """A learning process that lets the robot hop, and is killed."""
    plant = RealtimePlant(setup, folder, unattended)
    plant.start()
    plant.take_step(COMMAND)
    assert plant._session is not None
    pipe.send(plant._session.process_id)
    os.kill(os.getpid(), signal.SIGKILL)


def test_a_robot_lands_after_the_death_of_the_learning_process(tmp_path):
    context = get_context("spawn")
    here, there = context.Pipe()
    with live_ring(make_machine=RecordedTwin) as ring:
        process = context.Process(target=learn_and_die, args=(SETUP, tmp_path, there))
        process.start()
        there.close()
        orphan = here.recv()
        process.join()
        wait_for_end(orphan)
        behind = ring.look()
        assert behind.enabled == [False, False], "its drives were switched off, not only found by their watchdogs"
        given = np.array(behind.torques)
        assert np.abs(given).max() <= LIMITS.torque
        assert given[-2000:].any(), "it landed under control"
        check_off(ring)


def wait_for_end(process_id: int) -> None:
    """Waits until a process that is not a child of this one has ended."""
    descriptor = os.pidfd_open(process_id)
    try:
        assert select.select([descriptor], [], [], 600)[0], "it never ended"
    finally:
        os.close(descriptor)


def take_steps(plant, count):
    for _ in range(count):
        plant.take_step(COMMAND)


def test_on_a_full_disk_the_robot_lands_and_written_ticks_are_kept(tmp_path):
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with live_ring(make_machine=RecordedTwin) as ring:
        plant = RealtimePlant(SETUP, tmp_path, unattended)
        with plant:
            plant.start()
            resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "ticks-0.mcap").stat().st_size + 70_000, hard))
            try:
                with pytest.raises(RigFault, match=r"ticks-0\.mcap"):
                    take_steps(plant, 30)
            finally:
                resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        check_off(ring)


def test_without_a_person_holding_it_the_robot_gets_no_torque(tmp_path):
    @contextmanager
    def nobody(board):
        raise RigFault("nobody is there")
        yield

    with live_ring(make_machine=RecordedTwin) as ring, RealtimePlant(SETUP, tmp_path, nobody) as plant:
        with pytest.raises(RigFault, match="nobody is there"):
            plant.start()
        plant.stop()
        assert not np.array(ring.look().torques).any()


def test_a_missing_ring_is_reported(tmp_path):
    with RealtimePlant(SETUP, tmp_path, unattended) as plant, pytest.raises(RigFault, match="cannot be opened"):
        plant.start()


def test_a_command_that_is_not_finite_ends_the_deployment_and_the_next_one_has_its_own_log(tmp_path):
    with hopping(tmp_path) as (ring, plant):
        record = plant.take_step(np.array([np.nan, 0.0]))
        assert record.status == StepStatus.INVALID
        check_off(ring)
        plant.start()
        assert plant.take_step(COMMAND).status == StepStatus.OK
    assert len(logged(tmp_path, 0)) > 700
    assert len(logged(tmp_path, 1)) > 1000


def test_an_emergency_stop_from_the_learning_side(tmp_path):
    with hopping(tmp_path) as (ring, plant):
        session = plant._session
        assert session is not None
        session.board.stop_at_once()
        assert plant.take_step(COMMAND).status == StepStatus.STOPPED
        assert "emergency stop" in plant.fault
        assert session.board.request == Request.START
        check_off(ring)


def test_a_command_of_the_touchdown_acts_in_its_step(tmp_path):
    """The time of the ring goes on meanwhile; in lock-step, planning takes none of it."""
    uneven = HopperControl(ROBOT, GAINS, BOUNDS, ground=UnevenGround(measured_heights=True))
    other, found = COMMAND * 1.5, []

    def plan(touchdown):
        found.append(touchdown)
        return other

    with (
        live_ring(make_machine=RecordedTwin),
        RealtimePlant(replace(SETUP, robot_control=uneven), tmp_path, unattended) as plant,
    ):
        plant.start()
        records = [plant.take_replanned_step(COMMAND, plan) for _ in range(2)]
    for touchdown, record in zip(found, records, strict=True):
        assert record.status == StepStatus.OK
        np.testing.assert_array_equal(record.command, other)
        np.testing.assert_array_equal(record.requested, other)
        np.testing.assert_array_equal(touchdown.state, record.state)
        assert abs(touchdown.context["ground"]) < 0.01
        assert touchdown.context["ground"] == record.context["ground"]


def test_a_plan_that_comes_after_mid_stance_leaves_the_first_command(tmp_path):
    """The time of the ring goes on while the robot is planned for: 80 ms from the touchdown, and more."""
    uneven, took = HopperControl(ROBOT, GAINS, BOUNDS, ground=UnevenGround(measured_heights=True)), []

    with (
        live_ring(make_machine=RecordedTwin) as ring,
        RealtimePlant(replace(SETUP, robot_control=uneven), tmp_path, unattended) as plant,
    ):

        def plan(touchdown):
            before = ring.look().cycles
            while ring.look().cycles < before + 150:
                sleep(1e-3)
            took.append(ring.look().cycles - before)
            return COMMAND * 1.5

        plant.start()
        records = [plant.take_replanned_step(COMMAND, plan) for _ in range(2)]
    assert len(took) == 2
    for record in records:
        assert record.status == StepStatus.OK
        np.testing.assert_array_equal(record.command, COMMAND)
        np.testing.assert_array_equal(record.requested, COMMAND)
