"""The ring on a network interface: it answers frames until it is stopped."""

import gc
import os
import select
import signal
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from struct import Struct
from time import monotonic_ns, time_ns

from stepgap.base.signals import LOST_TERMINAL, terminated_as_interrupted
from stepgap.base.start_method import process_context
from stepgap.hardware.ethercat.emulator.frame import LONGEST_FRAME
from stepgap.hardware.ethercat.emulator.network import NoNetwork, wire
from stepgap.hardware.ethercat.emulator.ring import Machine, Ring
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings

_SO_TIMESTAMPNS = 35  # Socket option of Linux, and the type of its message; Python has no name for it

_TIMESPEC = Struct("@ll")


class ArrivalTimes:
    """Receives frames; called, it returns when the last one arrived [ns], on the monotonic clock."""

    def __init__(self) -> None:
        self._ahead = time_ns() - monotonic_ns()
        self._last = monotonic_ns()

    def __call__(self) -> int:
        """Returns the time [ns]."""
        return self._last

    @staticmethod
    def enable(raw: socket.socket) -> None:
        """Lets the kernel stamp the frames of a socket."""
        raw.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def receive(self, raw: socket.socket) -> bytes:
        """Receives a frame and keeps its time."""
        frame, messages, _, _ = raw.recvmsg(LONGEST_FRAME, socket.CMSG_SPACE(_TIMESPEC.size))
        self._last = monotonic_ns()
        for level, kind, data in messages:
            if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS):
                seconds, nanoseconds = _TIMESPEC.unpack(data)
                self._last = 10**9 * seconds + nanoseconds - self._ahead
        return frame


LARGEST_LAG = 100
"""Largest number of ticks that a ring on the wall clock catches up with; with more, its time lags behind."""

PRIORITY = 90  # Priority of SCHED_FIFO; above a master's, which on a single core would wait for a frame without end
READY = ""  # Message of the ring's process when it is ready; any other message is the reason why it failed


def run_emulator(
    interface: str,
    machine: Machine,
    settings: RingSettings,
    report: Callable[[str], None] = print,
    stop: Connection | None = None,
    now: Callable[[], int] | None = None,
) -> None:
    """Creates a veth pair, runs the ring on it until Ctrl-C, SIGTERM or `stop`, and deletes the pair.

    Args:
        interface: Name of the end that a master opens.
        machine: Machine that the drives move.
        report: Called once, when the ring is ready, with a line that names its interface.
        stop: Ends the ring when it becomes readable or is closed on the other side.
        now: Time of the slaves' clocks [ns]; by default that of the ticks in lock-step, otherwise the wall clock.

    Raises:
        NoNetwork: The interface cannot be created; the message contains the remedy.
        ValueError: The settings do not fit.
    """
    arrivals = ArrivalTimes()
    ring = Ring(machine, settings, now=now or (None if settings.lock_step else arrivals))
    _request_realtime()
    names = ", ".join(slave.device.name for slave in ring.slaves)
    with terminated_as_interrupted(), suppress(KeyboardInterrupt), wire(interface) as raw:
        report(f"EtherCAT ring on {interface}: {names}")
        period = None if settings.lock_step else round(machine.period * 1e9)
        arrivals.enable(raw)
        _serve(ring, raw, arrivals, stop, period)


@contextmanager
def emulated(
    interface: str, make_machine: Callable[[], Machine], settings: RingSettings, now: Callable[[], int] | None = None
) -> Iterator[None]:
    """Runs the ring in a separate process, which ends with the block, and also when this process dies.

    Args:
        interface: Name of the end that the master opens.
        make_machine: Creates the machine that the drives move, in that process; it must be possible to pickle it.
        now: Time of the slaves' clocks as for `run_emulator`, such as a `ComputedTime`; must be picklable.

    Raises:
        NoNetwork: The ring cannot be started; the message contains the remedy.
    """
    context = process_context()
    here, there = context.Pipe()
    process = context.Process(target=_run_in_process, args=(interface, make_machine, settings, there, now), daemon=True)
    process.start()
    there.close()
    with here:
        try:
            message = here.recv()
        except EOFError:
            message = "the ring's process ended before it was ready"
        if message != READY:
            process.join()
            raise NoNetwork(message)
        try:
            yield
        finally:
            here.close()
            process.join()


def _request_realtime() -> None:
    """Requests SCHED_FIFO, since a master waits for an answer no longer than half a tick."""
    gc.freeze()
    with suppress(AttributeError, PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _run_in_process(
    interface: str,
    make_machine: Callable[[], Machine],
    settings: RingSettings,
    parent: Connection,
    now: Callable[[], int] | None,
) -> None:
    for number in LOST_TERMINAL:  # also sent to the master, whose robot has to land: until then the ring is needed
        signal.signal(number, signal.SIG_IGN)
    try:
        run_emulator(interface, make_machine(), settings, lambda _: parent.send(READY), parent, now)
    except (NoNetwork, ValueError) as reason:
        parent.send(str(reason))


def _serve(ring: Ring, raw: socket.socket, arrivals: ArrivalTimes, stop: Connection | None, period: int | None) -> None:
    """Answers frames until `stop` is readable; `period` of a tick on the wall clock [ns], None in lock-step."""
    raw.setblocking(False)
    poll = select.poll()
    poll.register(raw, select.POLLIN)
    if stop is not None:
        poll.register(stop, select.POLLIN)
    due = monotonic_ns()
    while True:
        # the resolution of poll is a millisecond; on the wall clock a tick may be late, but none is skipped
        ready = poll.poll(None if period is None else max(0, (due - monotonic_ns() + 999_999) // 1_000_000))
        if period is not None:
            due = _catch_up(ring, due, period)
        for descriptor, _ in ready:
            if descriptor != raw.fileno():
                return
            for answer in ring.pass_frame(arrivals.receive(raw)):
                raw.send(answer)


def _catch_up(ring: Ring, due: int, period: int) -> int:
    """Makes the ticks that are due; returns when the next one is due [ns]."""
    now = monotonic_ns()
    due = max(due, now - LARGEST_LAG * period)
    while due <= now:
        ring.advance()
        due += period
    return due
