"""Hops a rig in real time: the loop runs in a process of its own, this one gives it a command for every hop."""

from collections.abc import Callable
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path
from threading import Event, Thread
from time import sleep

import numpy as np

from stepgap.plants.plant import Plant
from stepgap.plants.realtime.board import Board, Hop, Request
from stepgap.plants.realtime.loop import LOOP_UNITS
from stepgap.plants.realtime.process import RealtimeSetup, run_realtime
from stepgap.plants.realtime.states import RigState
from stepgap.plants.tick_log import TickLog, TickLogError, next_path
from stepgap.plants.tick_ring import TickRing
from stepgap.rigs.rig import RigFault
from stepgap.step import ADVICE, Array, Reason, StepRecord, StepSpace

KEPT_ROWS = 20_000
"""Ticks that the log may be behind without losing one."""

LOG_EVERY = 0.05
"""Time between two looks for new ticks [s]; a file that a crash cuts off lacks hardly more."""

LOOK_EVERY = 1e-3
"""Time between two looks whether a hop has ended [s]."""

LAST_WORDS = 5.0
"""Time beyond the longest landing that the real-time process may take to end [s]."""


class RealtimePlant(Plant):
    """Hops a rig that waits for nobody.

    A step ends when the apex has just been passed. The command acts from the next mid-stance on, some 0.3 s later; one
    that comes after that is not applied, and the record says so: its applied command is zero.

    Args:
        setup: The rig, and how it is controlled.
        logs: Folder for the ticks of every deployment, `ticks-*.mcap`; without, there is no such log.
        on_ready: Called when the rig is connected and limp, before torque is given for the first time.
    """

    def __init__(self, setup: RealtimeSetup, logs: Path | None = None, on_ready: Callable[[], None] = lambda: None):
        self._setup, self._logs, self._on_ready = setup, logs, on_ready
        self._space, self._session = setup.bounds.space(), None
        self._state, self._hop, self._fault = np.full(2, np.nan), 0, ""

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]."""
        return self._space

    @property
    def fault(self) -> str:
        """Why the last deployment ended before its time; empty while it has not."""
        return self._fault

    def start(self) -> Array:
        """Connects, takes the landing posture, waits until the robot is let go, and hops once without command.

        Raises:
            RigFault: The rig cannot be had, or the first hop failed.
        """
        self.stop()
        self._hop, self._fault = 0, ""
        self._session = session = Session(self._setup, self._logs)
        while session.board.state < RigState.READY:
            session.check()
            sleep(LOOK_EVERY)
        session.check()
        self._on_ready()
        session.board.request = Request.HOP
        hop = self._await_hop(session)
        if hop.reason != Reason.OK:
            said = f" ({self._fault})" if self._fault else ""
            raise RigFault(f"the first hop failed: {hop.reason.status}{said}: {ADVICE[hop.reason]}")
        return self._state

    def take_step(self, command: Array) -> StepRecord:
        """Hops once; a fall, a fault or a safety stop is a record without a next state, and the robot lands.

        Raises:
            RigFault: The log of ticks cannot be written.
        """
        session, state, asked = self._session, self._state, np.asarray(command, float)
        if session is None:
            raise RigFault("the rig is not started")
        within = np.clip(asked, self._space.command_lower, self._space.command_upper)
        if np.isnan(within).any():
            self.stop()
            return StepRecord(state, asked, within, np.full(2, np.nan), Reason.INVALID)
        self._hop += 1
        session.board.post_command(self._hop, *within.tolist())
        hop = self._await_hop(session)
        return StepRecord(state, asked, np.array([hop.applied_fx, hop.applied_fy]), self._state, hop.reason)

    def stop(self) -> None:
        """Lands the robot, torque off."""
        if self._session:
            self._session, session = None, self._session
            self._fault = self._fault or session.words()
            session.close(self._setup.loop.landing_time + LAST_WORDS)

    def _await_hop(self, session: "Session") -> Hop:
        """The present hop, when it has ended."""
        while (hop := session.board.hop(self._hop)) is None:
            if session.over():
                hop = session.board.hop(self._hop) or Hop(self._hop, np.nan, np.nan, 0.0, 0.0, Reason.STOPPED)
                break
            session.check_log()
            sleep(LOOK_EVERY)
        if hop.reason != Reason.OK:
            self._fault = session.words()
        self._state = np.array([hop.speed, hop.height])
        return hop


class Session:
    """A real-time process, its shared memory and its log, from start to end.

    Args:
        setup: What the process is to do.
        logs: Folder for the log of ticks, or None.
    """

    def __init__(self, setup: RealtimeSetup, logs: Path | None):
        self.board, self._ring = Board.create(), TickRing.create(len(LOOP_UNITS), KEPT_ROWS)
        self._over, self._log_error = Event(), ""
        self._logger = Thread(target=self._keep_log, args=(logs,), daemon=True)
        arguments = setup, self.board.name, self._ring.name
        self._process: BaseProcess = get_context("spawn").Process(target=run_realtime, args=arguments, daemon=True)
        self._process.start()
        self._logger.start()

    @property
    def process_id(self) -> int:
        """Of the real-time process."""
        return self._process.pid or 0

    def over(self) -> bool:
        """Whether the process has ended, in whatever way."""
        return not self._process.is_alive()

    def words(self) -> str:
        """What there is to say of the end."""
        if self._log_error:
            return self._log_error
        code = self._process.exitcode
        killed = f"the real-time process was killed by signal {-code}" if code is not None and code < 0 else ""
        return killed or self.board.words

    def check(self) -> None:
        """Raises RigFault where the process has failed or ended, or its log cannot be written."""
        if self.board.state == RigState.FAULT or self.over():
            raise RigFault(self.words() or "the real-time process ended")
        self.check_log()

    def check_log(self) -> None:
        """Raises RigFault where the log cannot be written; the robot has been asked to land then."""
        if self._log_error:
            raise RigFault(self._log_error)

    def close(self, patience: float) -> None:
        """Asks for the landing and waits for the end at most so long [s]; what has not ended then is killed."""
        self.board.request = Request.STOP
        self._process.join(patience)
        if self._process.is_alive():
            self.board.stop_at_once()
            self._process.join(1.0)
            self._process.kill()  # the drives' watchdog takes the torque away
            self._process.join()
        self._over.set()
        self._logger.join()
        for memory in (self._ring, self.board):
            memory.close()
            memory.unlink()

    def _keep_log(self, folder: Path | None) -> None:
        """Moves ticks to disk until all is over; a disk that is full lands the robot."""
        if folder is None:
            return
        try:
            with TickLog(next_path(folder), LOOP_UNITS) as log:
                over = False
                while not over:
                    over = self._over.wait(LOG_EVERY)
                    log.append(self._ring.drain())
                    log.flush()
        except TickLogError as error:
            self._log_error = str(error)
            self.board.request = Request.STOP
