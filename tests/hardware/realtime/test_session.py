"""A real-time process and its resources when a part fails; the rig never moves."""

import multiprocessing
import subprocess
import sys
import time
from multiprocessing import get_context, resource_tracker
from multiprocessing.shared_memory import SharedMemory
from pathlib import Path

import numpy as np
import pytest

from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.process import RealtimeSetup, run_realtime
from stepgap.hardware.realtime.session import Session
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLogError
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.rigs.rig import RigFault
from tests.hardware.realtime.still_robot import SETUP, Sink, StillRobot, still_rig

SHARED = Path("/dev/shm")


@pytest.fixture
def made(monkeypatch):
    """Shared memory that this process creates."""
    found = []

    class Watched(SharedMemory):
        def __init__(self, *args, **more):
            super().__init__(*args, **more)
            found.append(SHARED / self.name)

    monkeypatch.setattr("stepgap.plants.ticks.tick_ring.SharedMemory", Watched)
    return found


def wait_until(condition):
    for _ in range(60_000):
        if condition():
            return
        time.sleep(0.01)
    pytest.fail("it never came")


@pytest.mark.parametrize("stage", ["board", "ring", "process"])
def test_resources_are_released_after_a_failed_start(stage, monkeypatch, made):
    def full(*_):
        raise OSError(28, "No space left on device")

    setup, sink = SETUP, Sink()
    if stage == "process":
        setup = RealtimeSetup(lambda: still_rig(), StillRobot())  # cannot be pickled
    else:
        monkeypatch.setattr(*((Board, "create") if stage == "board" else (TickRing, "create")), full)
    with pytest.raises(
        Exception, match="pickle" if stage == "process" else "no shared memory .* No space left"
    ) as found:
        Session(setup, sink)
    assert stage == "process" or isinstance(found.value, RigFault)
    assert sink.closed
    assert len(made) == ("board", "ring", "process").index(stage)
    assert not any(path.exists() for path in made)
    assert not multiprocessing.active_children()


@pytest.mark.parametrize(
    "error", [TickLogError("ticks-0.mcap: No space left on device"), ValueError("a time of nan s")]
)
def test_a_sink_that_fails_ends_the_deployment(error):
    sink = Sink(error)
    session = Session(SETUP, sink)
    try:
        wait_until(session.over)
        with pytest.raises(RigFault, match=str(error)):
            session.check()
    finally:
        session.close()
    assert sink.closed
    assert str(error) in session.message()


def test_lost_ticks_are_reported_and_end_the_deployment(monkeypatch):
    """The reader waits until the ring is overwritten."""
    monkeypatch.setattr("stepgap.hardware.realtime.session.KEPT_ROWS", 3)
    monkeypatch.setattr("stepgap.hardware.realtime.session.DRAIN_EVERY", 0.2)
    sink = Sink()
    session = Session(SETUP, sink)
    try:
        wait_until(session.over)
        with pytest.raises(RigFault, match="ticks are missing in the log"):
            session.check()
        ticks = session.board.ticks
    finally:
        session.close()
    assert len(sink.rows) < ticks


def test_ctrl_c_during_the_landing_switches_torque_off_and_keeps_every_tick(made):
    sink = Sink()
    session = Session(SETUP, sink)
    wait_until(lambda: session.board.state == RigState.READY)
    join = session._process.join

    def interrupted(timeout=None):
        if timeout and timeout > 1:
            session.board.request = Request.NOTHING  # as if it had not come to it yet
            raise KeyboardInterrupt
        join(timeout)

    session._process.join = interrupted
    with pytest.raises(KeyboardInterrupt):
        session.close()
    assert session.over()
    assert "emergency stop" in session.message()
    assert sink.closed
    rows = np.array(sink.rows)
    assert rows[-1, list(SETUP.units).index("state")] in (RigState.READY, RigState.FAULT)
    assert len(made) == 2
    assert not any(path.exists() for path in made)


def test_the_death_of_the_parent_before_the_start_is_detected():
    """The parent's id is an argument; a process that asks for it late would get the id of the reaper of orphans.

    It frees the memory, so that this process may not do so a second time.
    """
    board, ring = Board.create(1, 3, 0), TickRing.create(len(SETUP.units), 10)
    process = get_context("spawn").Process(target=run_realtime, args=(SETUP, board.name, ring.name, 2**22))
    try:
        process.start()
        process.join(600)
        assert process.exitcode == 0
        assert board.state == RigState.OFF
        assert board.ticks > 0
        for name in (board.name, ring.name):
            assert not (SHARED / name).exists()
            resource_tracker.unregister(f"/{name}", "shared_memory")
    finally:
        process.kill()
        board.close()
        ring.close()


FULL = """
from stepgap.hardware.realtime.board import Board
from stepgap.plants.ticks.tick_ring import TickRing
board = Board.create(1, 3, 0)
try:
    TickRing.create(16, 20_000)
except OSError as error:
    print(error.strerror)
board.close()
board.unlink()
"""


def test_full_shared_memory_is_an_error_at_the_start_and_no_signal_during_a_hop(tmp_path):
    mount = 'mount -t tmpfs -o size=64k none /dev/shm && exec "$@"'
    command = ["unshare", "--user", "--map-root-user", "--mount", "sh", "-c", mount, "sh", sys.executable, "-c", FULL]
    try:
        outcome = subprocess.run(command, capture_output=True, text=True, timeout=600)
    except FileNotFoundError:
        pytest.skip("no unshare here")
    if "unshare:" in outcome.stderr or "mount:" in outcome.stderr:
        pytest.skip(outcome.stderr)
    assert (outcome.returncode, outcome.stdout, outcome.stderr) == (0, "No space left on device\n", "")
