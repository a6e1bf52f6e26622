"""Signals that end or stop a process while the robot hops: it lands or loses torque; no shared memory is left."""

import fcntl
import os
import select
import signal
import subprocess
import sys
import termios
from itertools import pairwise
from pathlib import Path

import pytest

from stepgap.plants.ticks.rig_state import RigState

PROGRAM = """
import sys
from dataclasses import replace
from pathlib import Path
from time import sleep

from stepgap.base.signals import terminated_as_interrupted
from stepgap.hardware.realtime.board import Request
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.session import Session
from stepgap.plants.ticks.rig_state import RigState
from tests.hardware.realtime.still_robot import SETUP, Sink

sink = Sink()
times = LoopSettings(calibrate_time=0.02, stand_time=0.02, landing_time=0.2, release_time=float("inf"))
times = replace(times, tick_silence=float(sys.argv[1]))
setup = replace(SETUP, loop=times)
with terminated_as_interrupted():
    session = Session(setup, sink)
    try:
        while session.board.state != RigState.STEP:
            session.check()
            session.board.request = Request.START
            sleep(0.01)
        started = Path("started.part")
        started.write_text(f"{session.process_id} {session.board.name} {session._ring.name}")
        started.rename("started")
        while not session.over():
            sleep(0.01)
    finally:
        session.close()
        Path("message").write_text(session.message())
        Path("states").write_text("".join(f"{row[0]} {int(row[-2])}\\n" for row in sink.rows))
"""
REPOSITORY = Path(__file__).parents[3]


@pytest.fixture
def tick_silence():
    """Longest time without a tick [s]; on a busy machine it may be long."""
    return 60.0


@pytest.fixture
def hopping(tmp_path, tick_silence):
    """A program whose robot hops, its terminal, its real-time process and the paths of its shared memory."""
    ours, theirs = os.openpty()
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(tick_silence)],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        start_new_session=True,
        preexec_fn=lambda: fcntl.ioctl(0, termios.TIOCSCTTY, 0),
    )
    os.close(theirs)
    started = tmp_path / "started"
    try:
        while not started.exists():
            assert program.poll() is None, os.read(ours, 100_000).decode()
            signal.sigtimedwait([], 0.01)
        process, *names = started.read_text().split()
        yield program, ours, int(process), [Path("/dev/shm", name) for name in names]
    finally:
        program.kill()
        program.wait()
        os.close(ours)


def check_landing(program, shared, folder):
    """The program ends by itself, after the robot has landed for its whole time; nothing is left behind."""
    program.wait(600)
    rows = [line.split() for line in (folder / "states").read_text().splitlines()]
    states = [RigState(int(state)) for _, state in rows]
    stop = [float(time) for (time, _), state in zip(rows, states, strict=True) if state == RigState.STOP]
    longest = max(
        float(late[0]) - float(early[0]) for early, late in pairwise(rows)
    )  # on a busy machine, ticks are late
    assert stop[-1] - stop[0] >= 0.2 - longest
    assert states[-1] in (RigState.STOP, RigState.OFF)
    assert RigState.FAULT not in states
    assert not any(path.exists() for path in shared)


@pytest.mark.parametrize("number", [signal.SIGHUP, signal.SIGQUIT])
def test_a_signal_to_the_learning_process_lands_the_robot(hopping, number, tmp_path):
    program, _, _, shared = hopping
    assert all(path.exists() for path in shared)
    program.send_signal(number)
    check_landing(program, shared, tmp_path)


def test_a_signal_to_the_realtime_process_lands_the_robot(hopping, tmp_path):
    program, _, process, shared = hopping
    os.kill(process, signal.SIGHUP)
    check_landing(program, shared, tmp_path)


def test_a_closed_terminal_lands_the_robot(hopping, tmp_path):
    """The kernel sends SIGHUP to both processes, and to the one that would free shared memory after them."""
    program, terminal, _, shared = hopping
    os.dup2(os.open(os.devnull, os.O_RDWR | os.O_CLOEXEC), terminal)  # the fixture closes this number
    check_landing(program, shared, tmp_path)


def test_ctrl_z_lands_the_robot(hopping, tmp_path):
    """It stops the learning process, but not the real-time process."""
    program, terminal, process, shared = hopping
    os.write(terminal, b"\x1a")
    wait_for_end(process)
    program.send_signal(signal.SIGCONT)
    check_landing(program, shared, tmp_path)


@pytest.mark.parametrize("tick_silence", [0.3])
def test_a_stopped_realtime_process_is_killed_and_the_run_ends(hopping, tmp_path):
    program, _, process, shared = hopping
    os.kill(process, signal.SIGSTOP)
    program.wait(600)
    assert "the real-time process made no tick for 0.3" in (tmp_path / "message").read_text()
    assert not Path(f"/proc/{process}").exists()
    assert not any(path.exists() for path in shared)


def test_after_a_killed_learning_process_no_shared_memory_is_left(hopping):
    """It leads its terminal's session, so that the kernel ends its resource tracker too, by SIGHUP."""
    program, _, process, shared = hopping
    program.kill()
    wait_for_end(process)
    assert not any(path.exists() for path in shared)


def test_after_a_killed_realtime_process_no_shared_memory_is_left(hopping, tmp_path):
    program, _, process, shared = hopping
    os.kill(process, signal.SIGKILL)
    program.wait(600)
    assert (tmp_path / "message").read_text() == "the real-time process was killed by signal 9"
    assert not any(path.exists() for path in shared)


def wait_for_end(process_id):
    """Waits for the end of a process, also of one whose parent does not wait for it."""
    descriptor = os.pidfd_open(process_id)
    try:
        assert select.select([descriptor], [], [], 600)[0], "it never ended"
    finally:
        os.close(descriptor)
