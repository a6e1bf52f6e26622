"""Consent of a person to torque: a key of the terminal that must be held, or Enter for a simulated robot.

A terminal repeats a key that is held and says nothing when it is released. So the process that reads the terminal
counts the presses on the board, and the control loop compares the count in every tick: without a new press for
`LoopSettings.release_time`, the key counts as released. The same happens if the reading process is stopped or killed,
or if the terminal is gone.
"""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import replace
from functools import partial
from math import inf
from threading import Event, Thread
from time import monotonic

from stepgap.hardware.realtime.board import Board
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.rigs.rig import RigFault

Consent = Callable[[Board], AbstractContextManager[None]]
"""Waits until a person consents to torque; within the block, the consent is on the board."""

KEY = b" "  # The space bar
NEEDED_PRESSES = 5  # Number of presses in a row by which the key is held: the first ones of a terminal come slowly
LONGEST_REPEAT = 0.25  # Longest time between two of them [s]; terminals repeat a key some 30 times per second
_LOOK_EVERY = 0.05  # Longest time for which the end of the block is not noticed [s]


@contextmanager
def hold_key(request: str, board: Board) -> Iterator[None]:
    """Waits until a person, who is shown the request, holds the space bar, and counts its presses on the board.

    Raises:
        RigFault: There is no terminal, or it was closed.
    """
    terminal = _terminal()
    with _unbuffered(terminal):
        print(request, file=sys.stderr)
        _await_hold(terminal)
        over = Event()
        reader = Thread(target=_count_presses, args=(terminal, board, over), daemon=True)
        board.presses += 1
        reader.start()
        try:
            yield
        finally:
            over.set()
            reader.join()


@contextmanager
def press_enter(board: Board) -> Iterator[None]:
    """Waits until a person presses Enter, which suffices for a simulated robot.

    Raises:
        RigFault: There is no terminal, or it was closed.
    """
    del board  # no key is held
    terminal = _terminal()
    _forget_input(terminal)
    print("Press Enter, and the simulated robot gets torque. Ctrl-C lands it.", file=sys.stderr)
    if not sys.stdin.readline():
        raise RigFault("Enter was not pressed, so no torque was given")
    yield


def supervised(loop: LoopSettings, request: str, simulated: bool) -> tuple[LoopSettings, Consent]:
    """Settings of a loop and the consent that it needs: a key that is held, but Enter alone for a simulated robot.

    Args:
        loop: Settings for a real robot.
        request: What a person is asked for, as `RobotControl.consent_request`.
    """
    return (replace(loop, release_time=inf), press_enter) if simulated else (loop, partial(hold_key, request))


def _terminal() -> int:
    """File descriptor of standard input, which must be a terminal."""
    if not sys.stdin.isatty():
        raise RigFault("standard input is not a terminal, so nobody can press a key, and no torque was given")
    return sys.stdin.fileno()


def _forget_input(terminal: int) -> None:
    import termios  # not available on Windows

    termios.tcflush(terminal, termios.TCIFLUSH)


@contextmanager
def _unbuffered(terminal: int) -> Iterator[None]:
    """Lets a terminal give each key at once and without echo; Ctrl-C remains a signal."""
    import termios  # not available on Windows
    import tty

    before = termios.tcgetattr(terminal)
    tty.setcbreak(terminal, termios.TCSAFLUSH)
    try:
        yield
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)


def _await_hold(terminal: int) -> None:
    """Waits until the key has come often enough in a row."""
    presses = 0
    last = 0.0
    while presses < NEEDED_PRESSES:
        select.select([terminal], [], [])
        typed = _read(terminal)
        now = monotonic()
        if not typed:
            raise RigFault("the terminal was closed, so no torque was given")
        if KEY in typed:
            presses = presses + typed.count(KEY) if now - last <= LONGEST_REPEAT else 1
            last = now


def _count_presses(terminal: int, board: Board, over: Event) -> None:
    """Counts presses on the board until the block is over or the terminal is closed."""
    while not over.is_set():
        if select.select([terminal], [], [], _LOOK_EVERY)[0]:
            typed = _read(terminal)
            if not typed:
                return
            board.presses += typed.count(KEY)


def _read(terminal: int) -> bytes:
    """What was typed; nothing if the terminal is closed."""
    try:
        return os.read(terminal, 1024)
    except OSError:
        return b""
