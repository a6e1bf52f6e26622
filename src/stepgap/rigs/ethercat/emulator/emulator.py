"""The ring on a network interface: frames come, answers go, until it is told to stop."""

import gc
import os
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from time import monotonic_ns

from stepgap.base.signals import terminated_as_interrupted
from stepgap.rigs.ethercat.emulator.frame import LONGEST_FRAME
from stepgap.rigs.ethercat.emulator.machine import Machine
from stepgap.rigs.ethercat.emulator.network import NoNetwork, wire
from stepgap.rigs.ethercat.emulator.ring import Ring
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings

LARGEST_LAG = 100
"""Ticks that a ring on the wall clock makes up for; where it falls further behind, its time stands still meanwhile."""

PRIORITY = 90
"""Of SCHED_FIFO; more than a master's, who waits for a frame as for hardware, on a single core for ever."""

READY = ""
"""What the ring's process says when it can be used; anything else is why it cannot."""


def run_emulator(
    interface: str,
    machine: Machine,
    settings: RingSettings,
    say: Callable[[str], None] = print,
    stop: Connection | None = None,
) -> None:
    """Makes a veth pair, serves the ring on it until Ctrl-C, SIGTERM or `stop`, and takes the pair away.

    Args:
        interface: Name of the end that a master opens.
        machine: What the drives move.
        settings: Of the ring.
        say: Is told once where the ring is, when it can be used.
        stop: Ends it when something can be read there, or it is closed on the other side.

    Raises:
        NoNetwork: The interface cannot be had; the message says what to do.
        ValueError: The settings do not fit.
    """
    ring = Ring(machine, settings)
    _ask_for_realtime()
    names = ", ".join(slave.device.name for slave in ring.slaves)
    with terminated_as_interrupted(), suppress(KeyboardInterrupt), wire(interface) as raw:
        say(f"EtherCAT ring on {interface}: {names}")
        period = None if settings.lock_step else round(machine.period * 1e9)
        _serve(ring, raw, stop, period)


@contextmanager
def emulated(interface: str, make_machine: Callable[[], Machine], settings: RingSettings) -> Iterator[None]:
    """The ring in a process of its own, which ends with the block, and also when this process dies.

    Args:
        interface: Name of the end that the master opens.
        make_machine: Makes what the drives move, in that process; it must be possible to pickle it.
        settings: Of the ring.

    Raises:
        NoNetwork: The ring cannot be had; the message says what to do.
    """
    context = get_context("spawn")
    here, there = context.Pipe()
    process = context.Process(target=_run_apart, args=(interface, make_machine, settings, there), daemon=True)
    process.start()
    there.close()
    with here:
        try:
            said = here.recv()
        except EOFError:
            said = "the ring's process ended before it was ready"
        if said != READY:
            process.join()
            raise NoNetwork(said)
        try:
            yield
        finally:
            here.close()
            process.join()


def _ask_for_realtime() -> None:
    """Asks for SCHED_FIFO, since a master waits for an answer no longer than half a tick."""
    gc.freeze()
    with suppress(AttributeError, PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))


def _run_apart(interface: str, make_machine: Callable[[], Machine], settings: RingSettings, parent: Connection) -> None:
    try:
        run_emulator(interface, make_machine(), settings, lambda _: parent.send(READY), parent)
    except (NoNetwork, ValueError) as reason:
        parent.send(str(reason))


def _serve(ring: Ring, raw: socket.socket, stop: Connection | None, period: int | None) -> None:
    """Answers frames until `stop` can be read; `period` of a tick on the wall clock [ns], none in lock-step."""
    raw.setblocking(False)
    poll = select.poll()
    poll.register(raw, select.POLLIN)
    if stop is not None:
        poll.register(stop, select.POLLIN)
    due = monotonic_ns()
    while True:
        # poll knows only milliseconds; on the wall clock a tick may come late, but none is left out
        ready = poll.poll(None if period is None else max(0, (due - monotonic_ns() + 999_999) // 1_000_000))
        if period is not None:
            due = _catch_up(ring, due, period)
        for descriptor, _ in ready:
            if descriptor != raw.fileno():
                return
            for answer in ring.pass_frame(raw.recv(LONGEST_FRAME)):
                raw.send(answer)


def _catch_up(ring: Ring, due: int, period: int) -> int:
    """Makes the ticks that are due [ns]; when the next one is."""
    now = monotonic_ns()
    due = max(due, now - LARGEST_LAG * period)
    while due <= now:
        ring.advance()
        due += period
    return due
