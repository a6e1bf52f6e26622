"""A rig on an emulated ring whose time is computed: it passes only where the master waits or works."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from time import sleep

import numpy as np
import pytest

from stepgap.hardware.bus_rig import HostTime
from stepgap.hardware.ethercat.emulator.clock import ClockError, ComputedTime
from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.emulator import emulated
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.ethercat.emulator.ring_settings import RingClocks, RingSettings
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.hopper.ethercat import RigSettings, hopper_on_ethercat
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.hardware.hopper.still import still_hopper
from stepgap.hardware.hopper.twin_machine import hopper_devices
from stepgap.hardware.realtime.pace import TickClock
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading, hopper_sensors

WkcError = pytest.importorskip("pysoem", reason="pysoem is locked for Linux only").WkcError

DRIVES = ("drive_1", "drive_2")
TICK = 1e-3
WORK = 5e-5
"""Time from the beginning of a tick to its frame [s]."""

HOP = 500
"""Time of a frame from one slave to the next [ns]."""


@dataclass(frozen=True)
class StillMachine(Machine):
    """Counts that never change; `cycle` is the time between two frames [s]."""

    cycle: float = TICK

    @property
    def period(self) -> float:
        return self.cycle

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        return hopper_devices(settings, self.cycle)

    def start(self) -> HopperReading:
        return HopperReading(0, 0, 0, 0, 0.0)

    def tick(self, torques: Torques) -> HopperReading:  # noqa: ARG002
        return self.start()


class SimulatedTime:
    """The true time [s], which a ring in another process reads."""

    def __init__(self) -> None:
        self.now, self.ring_time = 1.0, ComputedTime()
        self.pause(0.0)

    @property
    def host(self) -> HostTime:
        return HostTime(lambda: self.now, self.pause)

    def pause(self, duration: float) -> None:
        self.now += duration
        self.ring_time.set(round(1e9 * self.now))


def drifting_clocks(rng: np.random.Generator) -> tuple[ClockError, ...]:
    """Six clocks with errors up to ±100 ppm, of which 5 to 20 ppm vary slowly; the first two are far apart."""
    rates = [80.0, -80.0, *rng.uniform(-80, 80, 4)]
    return tuple(ClockError(rate, rng.uniform(5, 20), rng.uniform(30, 120)) for rate in rates)


def settings_with_sync0(interface: str, tick: float = TICK, frames: int = 1) -> RigSettings:
    """Settings of a ring in which SYNC0 is activated for both drives."""
    ring = RingSettings(clocks=RingClocks(need_sync0=DRIVES))
    sensors = hopper_sensors(still_hopper(tick).sensor_model)
    return replace(emulated_settings(sensors, RobotParameters(), ring, interface), frames_per_tick=frames)


class TimedRig:
    """Ticks of a rig as the control loop makes them."""

    def __init__(self, rig: EthercatRig, time: SimulatedTime):
        self.rig, self.time = rig, time
        self._frames = rig.sensor_model.frames_per_tick
        self._clock, self._start = TickClock(rig.sensor_model.tick), time.now

    def tick(self, late: float = 0.0, follow: bool = True) -> list[float]:
        """Runs a tick that begins late, and the frames between it and the next one.

        Args:
            late: Its delay [s].
            follow: Whether ticks follow the reference clock.

        Returns:
            How late each frame before these frames was at the reference clock [s]; shape (frames per tick,).
        """
        correction = self.rig.clock_correction(self._clock.slip)
        self._clock.shift(correction if follow else 0.0)
        first = self._exchange(self._clock.begin(late), WORK)
        worked = self.time.now - self._start
        return [first, *map(self._exchange, self._clock.frame_times(self._frames, worked))]

    def _exchange(self, due: float, work: float = 0.0) -> float:
        """Exchanges a frame at a time or, if it is over, at once; returns how late the one before was [s]."""
        self.time.pause(max(0.0, self._start + due - self.time.now))
        self.rig.read()
        self.time.pause(work)
        reads = self.time.ring_time.reads
        self.rig.write((0.0, 0.0))
        while self.time.ring_time.reads == reads:  # no time passes before the frame is at the ring
            sleep(0)
        assert self.rig._bus.steering
        return self.rig._bus.steering.offset

    def register(self, slave: int, address: int, size: int) -> int:
        """Reads a register of a slave controller; a busy computer may answer too late."""
        for _ in range(5):
            with suppress(WkcError):
                return int.from_bytes(self.rig._bus._master.slaves[slave]._fprd(address, size, 20_000), "little")
        raise TimeoutError

    def apart(self) -> int:
        """Difference of the drives' system times at the same true time [ns]."""
        return self.register(1, 0x0910, 8) - self.register(0, 0x0910, 8) - HOP


@contextmanager
def timed_rig(
    interface: str,
    clocks: tuple[ClockError, ...] = (),
    faults: tuple[Fault, ...] = (),
    settings: RigSettings | None = None,
) -> Iterator[TimedRig]:
    """A connected rig whose drives need SYNC0."""
    ring = RingSettings(clocks=RingClocks(clocks, HOP, DRIVES), faults=faults)
    time = SimulatedTime()
    found = settings or settings_with_sync0(interface)
    with emulated(interface, partial(StillMachine, found.cycle), ring, time.ring_time):
        rig = EthercatRig(found, hopper_on_ethercat(found, RobotParameters()).sensor_model, time.host)
        with rig:
            yield TimedRig(rig, time)
