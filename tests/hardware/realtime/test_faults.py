"""Faults between controller and motors, on an emulated ring with the twin."""

from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from math import inf
from pathlib import Path

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ethercat import hopper_on_ethercat
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.incident import Incident, describe_incident, read_incident
from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import LOOP_UNITS, ControlLoop, LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup
from stepgap.plants.ticks.log_description import LogEvent
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLog
from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopControl, HopperControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.tick_row import TICK_UNITS
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepStatus
from tests.hardware.ethercat.ring_process import INTERFACE, RecordedTwin, live_ring

pytest.importorskip("pysoem", reason="pysoem is locked for Linux only")

ROBOT, GAINS, BOUNDS = RobotParameters(), Gains(), CommandBounds()
LIMITS = SafetyLimits(torque=36.0, torque_step=20.0, joint_speed=80.0, fold_angle=2.6, lowest_hip=0.1, highest_hip=0.9)
LAYOUT = Twin(ROBOT, RealityGap(), np.random.default_rng(0)).sensor_model
WATCHDOG = 0.5
EMULATED_LIMITS = emulated_settings(LAYOUT, ROBOT, RingSettings()).limits
SETTINGS = replace(
    emulated_settings(LAYOUT, ROBOT, RingSettings(inputs_after_tick=True), INTERFACE),
    limits=LIMITS,
    watchdog=WATCHDOG,
    reply_timeout=0.45,  # a busy machine may keep the ring waiting, whose time stands still meanwhile
)
RIG_UNITS = hopper_on_ethercat(SETTINGS, ROBOT).diagnostic_units
COLUMN = {name: index for index, name in enumerate({**TICK_UNITS, **RIG_UNITS, **LOOP_UNITS})}
COMMAND = (-4.0, -3.0)
SHORT_TIMEOUT = 0.15
"""Reply timeout where frames are lost [s]: the master polls until it is over, and keeps a processor busy meanwhile."""
HOPPING = 640
"""Approximate number of ticks before the robot's first thrust."""


class Deployment:
    """A loop that hops the ring's robot, each hop with a command."""

    def __init__(self, rig):
        self.rig, self.board, self.rows, self.ticks = rig, Board.create(2, 2, 1), [], 0
        control = HopControl(rig.sensor_model, ROBOT, GAINS, rig.limits)
        times = LoopSettings(calibrate_time=0.05, stand_time=0.15, release_time=inf)
        self.loop = ControlLoop(rig, control, BOUNDS.space(), self.board, self.rows.append, times)
        self.board.request = Request.START
        self.hops = []

    def run(self, ticks):
        """Runs that many ticks, or until the robot is off; returns whether it is still running."""
        for _ in range(ticks):
            if not self.loop.tick():
                return False
            if hop := self.board.finished(len(self.hops)):
                self.hops.append(hop)
                self.board.post_command(len(self.hops), COMMAND)
        return True


@contextmanager
def deployment(*faults, reply_timeout=None):
    settings = replace(SETTINGS, reply_timeout=reply_timeout or SETTINGS.reply_timeout)
    with live_ring(*faults, make_machine=RecordedTwin) as ring, hopper_on_ethercat(settings, ROBOT) as rig:
        begun = Deployment(rig)
        try:
            yield ring, begun
        finally:
            begun.board.close()
            begun.board.unlink()


@cache
def cycles_to_connect() -> int:
    """Number of frames with outputs that a bring-up takes."""
    with deployment() as (ring, _):
        return ring.look().cycles


def at(fault: Fault) -> Fault:
    """The fault while the robot hops."""
    return fault.at(cycles_to_connect() + HOPPING)


SURVIVED = {
    "one lost frame": Fault("lost frames", 0),
    "two lost frames": Fault("lost frames", 0, cycles=2),
    "a late frame": Fault("late frame", 0),
    "a duplicated frame": Fault("duplicated frame", 0),
    "an emergency without more": Fault("emergency", 0, "drive_2"),
}


def incident_of(hopping: Deployment, path: Path) -> Incident:
    """The incident in the log of a deployment, written as a session writes it."""
    setup = RealtimeSetup(partial(hopper_on_ethercat, SETTINGS, ROBOT), HopperControl(ROBOT, GAINS, BOUNDS))
    with TickLog(path, setup.units, setup.described()) as log:
        log.append(np.array(hopping.rows))
        log.note(LogEvent.now(hopping.rows[-1][0], hopping.board.message))
    return read_incident(path, 1.0)


STOPPED = {
    "three lost frames": (Fault("lost frames", 0, cycles=3), "3 ticks in a row"),
    "a slave gone and back": (Fault("unplugged", 0, "coupler", cycles=20), "3 ticks in a row"),
    "a drive that loses power": (Fault("power lost", 0, "drive_1", cycles=2), "drive_1"),
    "a drive's fault": (Fault("trip", 0, "drive_2"), "slave 2 'drive_2' no longer accepts torque commands"),
    "a mapping error": (Fault("wrong mapping", 0, "drive_1"), "drive_1"),
    "a master that stalls past the watchdog": (Fault("silence", 0, ticks=600), "drive_1"),
}


@pytest.mark.parametrize("name", SURVIVED)
def test_the_robot_continues_hopping_after(name):
    with deployment(at(SURVIVED[name]), reply_timeout=SHORT_TIMEOUT) as (ring, hopping):
        assert hopping.run(HOPPING + 1500)
        assert len(hopping.hops) >= 2
        assert all(hop.status == StepStatus.OK for hop in hopping.hops)
        check_torques(ring, hopping)


@pytest.mark.parametrize("name", STOPPED)
def test_torque_is_off_for_good_and_the_log_explains_it_after(name, tmp_path):
    fault, expected = STOPPED[name]
    with deployment(at(fault), reply_timeout=SHORT_TIMEOUT) as (ring, hopping):
        assert not hopping.run(HOPPING + 1500)
        assert hopping.loop.state == RigState.FAULT
        assert expected in hopping.board.message
        assert len(hopping.rows) >= HOPPING - 5, "every tick before is kept"
        assert hopping.rows[-1][COLUMN["state"]] == RigState.FAULT
        check_torques(ring, hopping)
        explained = describe_incident(incident_of(hopping, tmp_path / "a.mcap"))
        assert "state: STEP → FAULT\n" in explained
        assert expected in explained
        behind = ring.wait(round(WATCHDOG * 1000) + 5)
        assert behind.now == [0.0, 0.0]
        assert behind.enabled == [False, False]
        ticks = len(behind.torques)
        assert not any(any(torques) for torques in ring.wait(200).torques[ticks - 1 :]), "nor does it come back"
        with pytest.raises(RigFault, match="start again"):
            hopping.rig.connect()


def test_an_application_that_hangs_is_detected_by_the_motion():
    """Its slave controller still processes frames, so neither working counter nor statusword shows the fault."""
    with deployment(at(Fault("stalled", 0, "drive_1", cycles=5000))) as (ring, hopping):
        assert not hopping.run(HOPPING + 5000)
        check_torques(ring, hopping)
        assert ring.wait(round(WATCHDOG * 1000) + 5).enabled[1] is False


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_not_finite_reaches_no_motor(bad):
    with deployment() as (ring, hopping):
        assert hopping.run(HOPPING)
        hopping.board.post_command(len(hopping.hops), (bad, 0.0))
        hopping.hops.append(None)
        hopping.run(3000)
        check_torques(ring, hopping)


def test_the_software_stop_reaches_the_drives():
    with deployment() as (ring, hopping):
        assert hopping.run(HOPPING)
        hopping.board.stop_at_once()
        assert not hopping.run(2)
        hopping.rig.close()
        assert ring.look().now == [0.0, 0.0]
        assert "emergency stop" in hopping.board.message


def test_between_two_ticks_a_fast_bus_repeats_the_torques():
    settings = replace(SETTINGS, frames_per_tick=4)
    with live_ring(make_machine=RecordedTwin) as ring, hopper_on_ethercat(settings, ROBOT) as rig:
        begun, frames = Deployment(rig), 0

        def pace(due):
            nonlocal frames
            frames += due > 0.0  # else the loop asks for the time
            if len(begun.rows) == 900:
                begun.board.request = Request.STOP
            return due

        before = len(ring.look().torques)
        begun.loop.run(pace)
        given = np.array(ring.look().torques)[before:]
        applied = np.array(begun.rows)[:, COLUMN["applied_1"] : COLUMN["applied_2"] + 1]
        begun.board.close()
        begun.board.unlink()
    assert frames == pytest.approx(4 * len(applied), abs=4)
    np.testing.assert_allclose(given[: 4 * len(applied) - 4], np.repeat(applied[:-1], 4, axis=0), atol=1e-9)


def check_torques(ring, hopping):
    """The actual torques of the drives were within limits, and equal those in the log."""
    given = np.array(ring.look().torques)
    assert np.isfinite(given).all()
    assert np.abs(given).max() <= LIMITS.torque
    assert np.abs(given).max() > 1, "it did something"
    applied = np.array(hopping.rows)[:, COLUMN["applied_1"] : COLUMN["applied_2"] + 1]
    applied = applied[np.isfinite(applied).all(axis=1)]
    assert np.abs(applied).max() <= LIMITS.torque
