"""Consent to torque at a terminal: what is typed gives torque as long as the key is held, and nothing else does."""

import os
import select
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from io import StringIO
from itertools import count
from pathlib import Path
from threading import Event, Thread
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from stepgap.hardware.realtime import consent
from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.consent import hold_key, press_enter
from stepgap.plants.ticks.rig_state import RigState
from stepgap.rigs.rig import RigFault
from tests.hardware.realtime.test_loop import COLUMN, Deployment

RELEASE = 0.5
"""Time without a press after which the key counts as released [s]."""


@contextmanager
def terminal_of_a_person(monkeypatch: pytest.MonkeyPatch, answer: Callable[[int], object]) -> Iterator[tuple[int, int]]:
    """A terminal as standard input, whose person answers the question; yields its two ends."""
    ours, theirs = os.openpty()

    class Screen(StringIO):
        def write(self, text: str) -> int:
            if text.strip():
                answer(ours)
            return len(text)

    with os.fdopen(theirs) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        monkeypatch.setattr(sys, "stderr", Screen())
        yield ours, theirs
    os.close(ours)


def a_board() -> Board:
    """A board of which only the number of presses is used."""
    return cast(Board, SimpleNamespace(presses=0))


@contextmanager
def pressing(terminal: int, key: bytes) -> Iterator[None]:
    """Repeats a key, as a terminal does while it is held."""
    over = Event()

    def press() -> None:
        while not over.wait(0.005):
            os.write(terminal, key)

    finger = Thread(target=press)
    finger.start()
    try:
        yield
    finally:
        over.set()
        finger.join()


@pytest.mark.parametrize("ask", [partial(hold_key, "Hold the space bar."), press_enter])
def test_without_a_terminal_nobody_is_asked_and_there_is_no_torque(
    ask: Any, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with Path(os.devnull).open() as no_keyboard:
        monkeypatch.setattr(sys, "stdin", no_keyboard)
        with pytest.raises(RigFault, match="not a terminal"), ask(a_board()):
            pass
    assert capsys.readouterr().err == ""


def test_a_terminal_that_is_closed_gives_no_torque(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        terminal_of_a_person(monkeypatch, lambda ours: os.write(ours, b"\x04")),  # end of input, as Ctrl-D
        pytest.raises(RigFault, match="Enter was not pressed"),
        press_enter(a_board()),
    ):
        pass


def test_input_before_the_question_is_not_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    with terminal_of_a_person(monkeypatch, lambda ours: os.write(ours, b"\n")) as (ours, theirs):
        os.write(ours, b"\n")
        with press_enter(a_board()):
            left = select.select([theirs], [], [], 0)[0]
        assert left == [], "the first answer was discarded, the second one was used"


def test_the_presses_of_a_held_key_are_counted_until_it_is_released(monkeypatch: pytest.MonkeyPatch) -> None:
    board, asked = a_board(), Event()
    with terminal_of_a_person(monkeypatch, lambda _: asked.set()) as (ours, theirs):
        before = termios.tcgetattr(theirs)
        with pressing(ours, b" "), hold_key("Hold the space bar.", board):
            first = board.presses
            assert first >= 1
            while board.presses < first + 3:
                asked.wait(0.01)
        assert asked.is_set()
        assert termios.tcgetattr(theirs) == before, "the terminal is as it was"
        after = board.presses
        os.write(ours, b"   ")
        assert board.presses == after, "the consent is over"


def test_other_keys_and_single_presses_are_no_held_key(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the clock of the test, a second passes between two presses; in the end the terminal is closed."""
    presses, seconds = [b" ", b"x", b" ", b"\n", b" ", b"  ", b"   ", b""], count()
    monkeypatch.setattr(consent, "monotonic", lambda: float(next(seconds)))
    monkeypatch.setattr(consent, "_read", lambda _: presses.pop(0))
    monkeypatch.setattr(consent.select, "select", lambda *_: ([0], [], []))
    board = a_board()
    with (
        terminal_of_a_person(monkeypatch, lambda _: None),
        pytest.raises(RigFault, match="the terminal was closed"),
        hold_key("Hold the space bar.", board),
    ):
        pass
    assert (presses, board.presses) == ([], 0)


# The control loop, tick by tick


def pressed_until(time: float, deployment: Deployment) -> Callable[[], bool]:
    """Holds the key until a time [s]; then runs on until the robot is off."""

    def press() -> bool:
        if deployment.loop._clock.time < time:
            deployment.board.presses += 1
        return False

    return press


def torques(deployment: Deployment) -> np.ndarray:
    """Torques of all ticks; those after the end are zero [N·m]."""
    return np.nan_to_num(np.array(deployment.rows)[:, COLUMN["applied_1"] : COLUMN["applied_2"] + 1])


def test_without_the_key_there_is_no_torque_however_long_one_waits() -> None:
    with Deployment(release_time=RELEASE, hold=10.0) as deployment:
        deployment.board.request = Request.START
        for _ in range(2000):
            assert deployment.loop.tick()
        assert deployment.loop.state == RigState.READY
        assert not torques(deployment).any()


def test_a_key_released_before_the_robot_hops_switches_torque_off() -> None:
    with Deployment(release_time=RELEASE) as deployment:
        deployment.board.request = Request.START
        assert not deployment.run(pressed_until(0.18, deployment))
        assert deployment.loop.state == RigState.FAULT
        assert deployment.board.message == "the key was released before the first step: torque is off"
        given = np.flatnonzero(torques(deployment).any(axis=1))
        assert 300 < given[-1] <= 1000 * (0.18 + RELEASE) + 1


def test_a_key_released_while_the_robot_hops_lands_it() -> None:
    with Deployment(release_time=RELEASE, hold=0.9) as deployment:
        deployment.board.request = Request.START
        assert not deployment.run(pressed_until(1.6, deployment))
        assert deployment.board.message == "the key was released: the robot lands"
        states = [RigState(int(row[COLUMN["state"]])).name for row in deployment.rows]
        assert list(dict.fromkeys(states)) == ["CALIBRATE", "READY", "STAND", "STEP", "STOP", "OFF"]
        assert 1.6 + RELEASE <= 1e-3 * states.index("STOP") <= 1.6 + RELEASE + 2e-3
        assert deployment.rows[-1][COLUMN["measured_height"]] < 0.3, "it sits on the ground"


def test_the_robot_hops_as_long_as_the_key_is_held() -> None:
    with Deployment(release_time=RELEASE) as deployment:
        deployment.board.request = Request.START
        press = pressed_until(60.0, deployment)
        deployment.run(lambda: press() or deployment.board.finished(0) is not None)
        assert deployment.loop.state == RigState.STEP
