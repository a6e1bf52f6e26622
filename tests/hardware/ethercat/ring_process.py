"""An emulated ring in a separate process that reports the torques of its drives."""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from select import select
from typing import NamedTuple

import numpy as np
import pytest

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.emulator import PRIORITY
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.frame import LONGEST_FRAME
from stepgap.hardware.ethercat.emulator.network import NoNetwork, wire
from stepgap.hardware.ethercat.emulator.ring import Machine, Ring
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.twin_machine import TwinMachine, hopper_devices
from stepgap.rigs.rig import RigFault, Torques
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from tests.hardware.ethercat.recording import recording

INTERFACE = f"sg{os.getpid()}"  # tests may run side by side


class Behind(NamedTuple):
    """State of the ring's process.

    Attributes:
        cycles: Number of frames with outputs so far.
        torques: Torques of the drives in every tick of the machine [N·m].
        enabled: Which drives are enabled.
        now: Present torques of the drives [N·m].
    """

    cycles: int
    torques: list[Torques]
    enabled: list[bool]
    now: list[float]


class RecordingMachine(Machine):
    """A machine that keeps its torques."""

    torques: list[Torques]


class Recorder(RecordingMachine):
    """Records torques; its sensors count its ticks."""

    def __init__(self) -> None:
        self.torques = []

    @property
    def period(self) -> float:
        return 1e-3

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        return hopper_devices(settings, self.period)

    def start(self) -> HopperReading:
        self.torques = []
        return self._reading()

    def tick(self, torques: Torques) -> HopperReading:
        self.torques.append(torques)
        return self._reading()

    def _reading(self) -> HopperReading:
        ticks = len(self.torques)
        return HopperReading(ticks, 10 * ticks, -ticks, 2 * ticks, 0.5 * ticks)


class RecordedTwin(TwinMachine, RecordingMachine):
    """The twin, held until 0.2 s after its first torque, however late that comes; by then the robot stands.

    It records all torques, also those before its last restart.
    """

    def __init__(self) -> None:
        super().__init__(Twin(RobotParameters(), RealityGap(), np.random.default_rng(0), hold=0.2))
        self.torques = []

    def start(self) -> HopperReading:
        self._limp = True
        self._reading = super().start()
        return self._reading

    def tick(self, torques: Torques) -> HopperReading:
        self.torques.append(torques)
        self._limp = self._limp and not any(torques)
        return self._reading if self._limp else super().tick(torques)


class LiveRing:
    """The test's end of the process."""

    def __init__(self, pipe: Connection):
        self._pipe = pipe

    def look(self) -> Behind:
        return self.wait(0)

    def wait(self, ticks: int) -> Behind:
        """Lets time pass without frames."""
        self._pipe.send(ticks)
        return self._pipe.recv()


@contextmanager
def skipping_without_network() -> Iterator[None]:
    """Skips a test whose rig contains a ring, where raw sockets are not allowed."""
    try:
        yield
    except RigFault as fault:
        if "raw Ethernet needs" in str(fault):
            pytest.skip(str(fault))
        raise


def lose_nothing(frame: bytes) -> bool:
    return False


@contextmanager
def live_ring(
    *faults: Fault,
    make_machine: Callable[[], RecordingMachine] = Recorder,
    frames: Path | None = None,
    is_lost: Callable[[bytes], bool] = lose_nothing,
) -> Iterator[LiveRing]:
    """A ring in lock-step; skips the test where raw sockets are not allowed.

    With `frames`, all frames that came and went are in that file after the block (pcap). Frames for which `is_lost`
    is true do not reach the ring.
    """
    context = get_context("forkserver")
    here, there = context.Pipe()
    process = context.Process(
        target=_serve, args=(INTERFACE, there, faults, make_machine, frames, is_lost), daemon=True
    )
    process.start()
    there.close()
    with here:
        message = here.recv()
        if message:
            process.join()
            assert "exists" not in message, f"another test left its ring: {message}"
            pytest.skip(message)
        try:
            yield LiveRing(here)
        finally:
            here.close()
            process.join()


def _serve(
    interface: str,
    pipe: Connection,
    faults: tuple[Fault, ...],
    make_machine: Callable[[], RecordingMachine],
    frames: Path | None,
    is_lost: Callable[[bytes], bool],
) -> None:
    with suppress(PermissionError):  # pysoem waits 2 ms for some answers, less than a busy machine may take
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    machine = make_machine()
    ring = Ring(machine, RingSettings(inputs_after_tick=True, faults=faults))
    try:
        with wire(interface) as raw, recording(frames) as record:
            pipe.send("")
            while True:
                ready = select([raw, pipe], [], [])[0]
                if pipe in ready:
                    for _ in range(pipe.recv()):
                        ring.advance()
                    drives = ring.drives
                    enabled, now = [drive.is_enabled for drive in drives], [drive.torque for drive in drives]
                    pipe.send(Behind(ring.cycles, machine.torques, enabled, now))
                elif raw in ready:
                    frame = raw.recv(LONGEST_FRAME)
                    record(frame)
                    for answer in () if is_lost(frame) else ring.pass_frame(frame):
                        record(answer)
                        raw.send(answer)
    except NoNetwork as refused:
        pipe.send(str(refused))
    except EOFError:
        return
