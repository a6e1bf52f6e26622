"""A real-time process from start to end: its shared memory, its ticks and its final message."""

import os
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from math import isnan, nan
from multiprocessing import get_context
from multiprocessing.connection import wait
from multiprocessing.process import BaseProcess
from threading import Event, Thread
from time import sleep
from typing import Protocol, Self

from stepgap.hardware.realtime.board import Board, Request
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.hardware.realtime.process import RealtimeSetup, run_realtime
from stepgap.plants.ticks.log_description import LogEvent
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_log import TickLogError
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.rigs.rig import RigFault
from stepgap.step import Array

EXIT_TIME = 5.0  # Longest time from the last tick to the end of the process [s]


class TickWatch:
    """Measures how long a process has made no tick.

    The time is the sum of what the observer has waited between its looks, not that of a clock: a pause of the observer
    itself, as when the whole computer sleeps, is not a silence of the process.
    """

    def __init__(self, board: Board, settings: LoopSettings):
        self._board = board
        self._settings = settings
        self._ticks = 0
        self._silence = 0.0

    def silent(self, waited: float) -> str:
        """Describes a silence that is too long; empty if it is not. `waited` is the time since the last look [s]."""
        ticks = self._board.ticks
        self._silence = 0.0 if ticks != self._ticks else self._silence + waited
        self._ticks = ticks
        if self._silence <= self._longest():
            return ""
        return (
            f"the real-time process made no tick for {self._silence:.1f} s and was killed; "
            "the watchdog of the drives switches torque off"
        )

    def _longest(self) -> float:
        """Longest silence in the present state [s]."""
        if not self._ticks:
            return self._settings.connect_time
        over = self._board.state in (RigState.OFF, RigState.FAULT)
        return EXIT_TIME if over else self._settings.tick_silence


KEPT_ROWS = 20_000  # Largest number of ticks that the reader may be behind without a loss
DRAIN_EVERY = 0.05  # Time between two reads of new ticks [s]
FLUSH_EVERY = 20  # Number of reads between two flushes; a file that a crash truncates lacks hardly more
FIRST_TICKS = "the first ticks"  # Text of an event that relates the time of the ticks to UTC
_LOOK_EVERY = 1e-3  # Time between two looks whether the rig is ready [s]
WATCH_EVERY = 0.05  # Time between two looks whether there are ticks [s]


class TickSink(Protocol):
    """Destination of ticks, such as a `TickLog`; one in memory overrides only `append`."""

    def append(self, rows: Array) -> None:
        """Takes ticks, with the fields of `RealtimeSetup.units`; shape (k, fields)."""

    def note(self, event: LogEvent) -> None:
        """Takes a message about the deployment."""

    def flush(self) -> None:
        """Makes the ticks durable."""

    def close(self) -> None:
        """Ends the sequence of ticks; may be called twice."""


class Session:
    """A real-time process, its shared memory, the thread that reads its ticks, and the one that watches them.

    A process that makes no ticks any more is killed. Leaving its context closes the session.

    Args:
        setup: Setup of the process.
        sink: Takes every tick, from a separate thread, and is always closed at the end. If it fails, as on a full disk,
            or is too slow, the robot is landed.
        evidence: Evidence against the sensors from the deployment before.

    Attributes:
        evidence: That after this one, once it is closed.

    Raises:
        RigFault: There is not enough shared memory.
    """

    def __init__(self, setup: RealtimeSetup, sink: TickSink, evidence: Sequence[float] = ()):
        self._exit_timeout = setup.loop.landing_time + EXIT_TIME
        self._over = Event()
        self.evidence = tuple(evidence)
        self._sink_error = ""
        self._silent = ""
        self._final_message: str | None = None
        self._drain = Thread(target=self._move_ticks, args=(sink,), daemon=True)
        self._watch = Thread(target=self._watch_ticks, args=(setup.loop,), daemon=True)
        with ExitStack() as stack:
            stack.callback(sink.close)
            try:
                space = setup.robot_control.space
                self.board = Board.create(len(space.state), len(space.command), len(space.context))
                self.board.evidence = evidence
                stack.callback(self.board.unlink)
                stack.callback(self.board.close)
                self._ring = stack.enter_context(TickRing.create(len(setup.units), KEPT_ROWS))
            except OSError as error:
                raise RigFault(f"no shared memory for the ticks: {error.strerror}; free space in /dev/shm") from None
            arguments = setup, self.board.name, self._ring.name, os.getpid()
            # a child of this process and of no fork server, whose death it would have to notice instead
            self._process: BaseProcess = get_context("spawn").Process(target=run_realtime, args=arguments, daemon=True)
            self._process.start()
            self._drain.start()
            self._watch.start()
            self._kept = stack.pop_all()

    @property
    def process_id(self) -> int:
        """Id of the real-time process."""
        return self._process.pid or 0

    def over(self) -> bool:
        """Whether the process has ended, for any reason."""
        return not self._process.is_alive()

    def message(self) -> str:
        """Reason of the end, or, before the end, the requests that the kernel refused; empty if there is none."""
        if self._final_message is not None:
            return self._final_message
        code = self._process.exitcode
        killed = f"the real-time process was killed by signal {-code}" if code is not None and code < 0 else ""
        return self._sink_error or self._silent or killed or self.board.message

    def check(self) -> None:
        """Ensures that the process is running.

        Raises:
            RigFault: The process has failed or ended, or its ticks cannot be stored.
        """
        if self.board.state == RigState.FAULT or self.over():
            raise RigFault(self.message() or "the real-time process ended")
        self.check_sink()

    def await_ready(self) -> None:
        """Waits until the rig is connected, and limp.

        Raises:
            RigFault: As for `check`.
        """
        while self.board.state < RigState.READY:
            self.check()
            sleep(_LOOK_EVERY)
        self.check()

    def check_sink(self) -> None:
        """Ensures that ticks are stored.

        Raises:
            RigFault: They are not; the landing has been requested.
        """
        if self._sink_error:
            raise RigFault(self._sink_error)

    def close(self) -> None:
        """Requests the landing and waits for the end; all ticks are stored. A process that does not end is killed.

        Ctrl-C meanwhile is the software stop.
        """
        self.board.request = Request.STOP
        try:
            self._process.join(self._exit_timeout)
        finally:
            self._end()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    def _end(self) -> None:
        """Ends the process, if it is still running, and releases all resources."""
        if self._process.is_alive():
            self.board.stop_at_once()
            self._process.join(1.0)
            self._process.kill()  # the drives' watchdog switches torque off
            self._process.join()
        self._over.set()
        self._watch.join()
        self._drain.join()
        self._final_message = self.message()
        self.evidence = self.board.evidence
        self._kept.close()

    def _watch_ticks(self, settings: LoopSettings) -> None:
        """Kills the process when it makes no ticks any more."""
        watch = TickWatch(self.board, settings)
        while not self._over.wait(WATCH_EVERY):
            if wait([self._process.sentinel], 0):
                return  # it has ended by itself
            if silent := watch.silent(WATCH_EVERY):
                self._silent = silent
                self._process.kill()
                return

    def _move_ticks(self, sink: TickSink) -> None:
        """Moves ticks and messages into the sink until the process has ended."""
        over = False
        reads = 0
        time = nan
        noted = ""
        try:
            while not over:
                over = self._over.wait(DRAIN_EVERY)
                rows = self._ring.drain()
                message = self._silent or self.board.message
                sink.append(rows)
                if len(rows):
                    first = isnan(time)
                    time = float(rows[-1, 0])
                    if first:
                        sink.note(LogEvent.now(time, FIRST_TICKS))
                if message not in ("", noted):
                    sink.note(LogEvent.now(time, message))
                    noted = message
                if self._ring.lost and not self._sink_error:
                    self._land(f"{self._ring.lost} ticks are missing in the log, which was not written fast enough")
                reads += 1
                if reads % FLUSH_EVERY == 0:
                    sink.flush()
            sink.close()
        except Exception as error:
            # after any error: a robot whose ticks are not stored must not continue
            self._land(str(error) if isinstance(error, TickLogError) else f"the log of ticks failed: {error!r}")
            with suppress(Exception):
                sink.close()

    def _land(self, sink_error: str) -> None:
        self._sink_error = sink_error
        self.board.request = Request.STOP
