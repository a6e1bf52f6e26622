"""Signals that end a run while the robot hops: it lands, and no shared memory is left behind; with real processes."""

import fcntl
import os
import signal
import subprocess
import sys
import termios
from itertools import pairwise
from pathlib import Path

import pytest

from stepgap.plants.realtime.states import RigState

PROGRAM = """
from dataclasses import replace
from pathlib import Path
from time import sleep

from stepgap.base.signals import terminated_as_interrupted
from stepgap.plants.realtime.board import Request
from stepgap.plants.realtime.loop import LoopSettings
from stepgap.plants.realtime.session import Session
from stepgap.plants.realtime.states import RigState
from tests.plants.realtime.test_session import SETUP, Sink

sink = Sink()
setup = replace(SETUP, loop=LoopSettings(calibrate_time=0.02, stand_time=0.02, landing_time=0.2))
with terminated_as_interrupted():
    session = Session(setup, sink)
    try:
        while session.board.state != RigState.HOP:
            session.check()
            session.board.request = Request.HOP
            sleep(0.01)
        started = Path("started.part")
        started.write_text(f"{session.process_id} {session.board.name} {session._ring.name}")
        started.rename("started")
        while not session.over():
            sleep(0.01)
    finally:
        session.close()
        Path("states").write_text("".join(f"{row[0]} {int(row[-2])}\\n" for row in sink.rows))
"""
REPOSITORY = Path(__file__).parents[3]


@pytest.fixture
def hopping(tmp_path):
    """A program whose robot hops, its terminal, its real-time process and the paths of its shared memory."""
    ours, theirs = os.openpty()
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM],
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
    program, terminal, _, shared = hopping
    assert all(path.exists() for path in shared)
    program.send_signal(number)
    check_landing(program, shared, tmp_path)
    os.close(terminal)


def test_a_signal_to_the_realtime_process_lands_the_robot(hopping, tmp_path):
    program, terminal, process, shared = hopping
    os.kill(process, signal.SIGHUP)
    check_landing(program, shared, tmp_path)
    os.close(terminal)


def test_a_closed_terminal_lands_the_robot(hopping, tmp_path):
    """The kernel sends SIGHUP to both processes, and to the one that would free shared memory after them."""
    program, terminal, _, shared = hopping
    os.close(terminal)
    check_landing(program, shared, tmp_path)
