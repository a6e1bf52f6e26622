"""A real-time process from start to end: its shared memory, its ticks, its last words."""

import os
from contextlib import ExitStack, suppress
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from threading import Event, Thread
from typing import Protocol

from stepgap.plants.realtime.board import Board, Request
from stepgap.plants.realtime.loop import LOOP_UNITS
from stepgap.plants.realtime.process import RealtimeSetup, run_realtime
from stepgap.plants.realtime.states import RigState
from stepgap.plants.ticks.tick_log import TickLogError
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.rigs.rig import RigFault
from stepgap.step import Array

KEPT_ROWS = 20_000
"""Ticks that the reader may be behind without losing one."""

DRAIN_EVERY = 0.05
"""Time between two looks for new ticks [s]."""

FLUSH_EVERY = 20
"""Looks from one flush to the next; a file that a crash cuts off lacks hardly more."""

LAST_WORDS = 5.0
"""Time beyond the longest landing that the process may take to end [s]."""


class TickSink(Protocol):
    """Where ticks go, such as a `TickLog`."""

    def append(self, rows: Array) -> None:
        """Takes ticks, fields of the robot's control and `LOOP_UNITS`; shape (k, fields)."""

    def flush(self) -> None:
        """Makes sure of what it took."""

    def close(self) -> None:
        """No more will come; may be called twice."""


class Session:
    """A real-time process and what belongs to it.

    Args:
        setup: What the process is to do.
        sink: Takes every tick, from a thread of its own, and is closed in the end, in whatever way that comes. If it
            fails, as on a full disk, or does not keep up, the robot is landed.

    Raises:
        RigFault: There is no shared memory left.
    """

    def __init__(self, setup: RealtimeSetup, sink: TickSink):
        self._patience = setup.loop.landing_time + LAST_WORDS
        self._over, self._sink_error = Event(), ""
        self._last_words: str | None = None
        self._drain = Thread(target=self._move_ticks, args=(sink,), daemon=True)
        with ExitStack() as stack:
            stack.callback(sink.close)
            try:
                self.board = Board.create()
                stack.callback(self.board.unlink)
                stack.callback(self.board.close)
                self._ring = stack.enter_context(
                    TickRing.create(len(setup.robot_control.units) + len(LOOP_UNITS), KEPT_ROWS)
                )
            except OSError as error:
                raise RigFault(f"no shared memory for the ticks: {error.strerror}; make room in /dev/shm") from None
            arguments = setup, self.board.name, self._ring.name, os.getpid()
            self._process: BaseProcess = get_context("spawn").Process(target=run_realtime, args=arguments, daemon=True)
            self._process.start()
            self._drain.start()
            self._kept = stack.pop_all()

    @property
    def process_id(self) -> int:
        """Of the real-time process."""
        return self._process.pid or 0

    def over(self) -> bool:
        """Whether the process has ended, in whatever way."""
        return not self._process.is_alive()

    def words(self) -> str:
        """What there is to say of the end; before it, of what the kernel refused."""
        if self._last_words is not None:
            return self._last_words
        code = self._process.exitcode
        killed = f"the real-time process was killed by signal {-code}" if code is not None and code < 0 else ""
        return self._sink_error or killed or self.board.words

    def check(self) -> None:
        """Makes sure that it goes on.

        Raises:
            RigFault: The process has failed or ended, or its ticks cannot be kept.
        """
        if self.board.state == RigState.FAULT or self.over():
            raise RigFault(self.words() or "the real-time process ended")
        self.check_sink()

    def check_sink(self) -> None:
        """Makes sure that ticks are kept.

        Raises:
            RigFault: They are not; the robot has been asked to land.
        """
        if self._sink_error:
            raise RigFault(self._sink_error)

    def close(self) -> None:
        """Asks for the landing and waits for the end, every tick kept; a process that does not come to it is killed.

        Ctrl-C meanwhile is the software stop.
        """
        self.board.request = Request.STOP
        try:
            self._process.join(self._patience)
        finally:
            self._end()

    def _end(self) -> None:
        """The end of a process that is over, or that must be now."""
        if self._process.is_alive():
            self.board.stop_at_once()
            self._process.join(1.0)
            self._process.kill()  # the drives' watchdog takes the torque away
            self._process.join()
        self._over.set()
        self._drain.join()
        self._last_words = self.words()
        self._kept.close()

    def _move_ticks(self, sink: TickSink) -> None:
        """Moves ticks into the sink until all is over."""
        over, looks = False, 0
        try:
            while not over:
                over = self._over.wait(DRAIN_EVERY)
                sink.append(self._ring.drain())
                if self._ring.lost and not self._sink_error:
                    self._land(f"{self._ring.lost} ticks are missing in the log, which was not written fast enough")
                looks += 1
                if looks % FLUSH_EVERY == 0:
                    sink.flush()
            sink.close()
        except Exception as error:
            # whatever it is, a robot whose ticks are not kept must not go on
            self._land(str(error) if isinstance(error, TickLogError) else f"the log of ticks failed: {error!r}")
            with suppress(Exception):
                sink.close()

    def _land(self, sink_error: str) -> None:
        self._sink_error = sink_error
        self.board.request = Request.STOP
