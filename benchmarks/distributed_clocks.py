"""Ticks on distributed clocks: drives that need SYNC0, clocks that drift, and the loop that follows them.

    ./go python benchmarks/distributed_clocks.py --ticks 1000000

The ring runs in lock-step over a veth pair with SOEM as its master, in this process. Its time is computed, not measured:
a tick begins when the control loop asks for it, later by a delay of normal times and, rarely, by a large one.
"""

from argparse import ArgumentParser
from dataclasses import replace
from time import perf_counter

import numpy as np

from stepgap.plants.tick_clock import TickClock
from stepgap.rigs.ethercat.distributed_clocks import HostTime
from stepgap.rigs.ethercat.emulator.clock import ClockError, ComputedTime
from stepgap.rigs.ethercat.emulator.device import EmulatedDevice
from stepgap.rigs.ethercat.emulator.emulator import emulated
from stepgap.rigs.ethercat.emulator.faults import Fault, LostFrames
from stepgap.rigs.ethercat.emulator.machine import Machine
from stepgap.rigs.ethercat.emulator.ring_settings import RingClocks, RingSettings
from stepgap.rigs.ethercat.ethercat_rig import EthercatRig
from stepgap.rigs.rig import RigFault, Torques
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.ring_rig import emulated_settings
from stepgap.robots.hopper.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin_machine import hopper_devices

INTERFACE = "stepgapdc"
DRIVES = ("drive_1", "drive_2")
TICK = 1e-3


class StillMachine(Machine):
    """Counts that never change."""

    @property
    def period(self) -> float:
        return TICK

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        return hopper_devices(settings, TICK)

    def start(self) -> HopperReading:
        return HopperReading(0, 0, 0, 0, 0.0)

    def tick(self, torques: Torques) -> HopperReading:
        return self.start()


class SimulatedTime:
    """The true time [s], which passes only where a program waits or works."""

    def __init__(self, rng: np.random.Generator, jitter: float, outlier: float, outliers: float):
        self._rng, self._jitter, self._outlier, self._outliers = rng, jitter, outlier, outliers
        self.time, self.ring_time = 1.0, ComputedTime()
        self.pause(0.0)

    def now(self) -> float:
        return self.time

    def pause(self, duration: float) -> None:
        self.time += duration
        self.ring_time.set(round(1e9 * self.time))

    def pace(self, due: float, start: float) -> float:
        """Waits until a due time since the start and returns the time."""
        late = self._rng.exponential(self._jitter)
        if self._rng.random() < self._outliers:
            late += self._rng.uniform(0, self._outlier)
        self.pause(max(0.0, start + due - self.time) + late)
        return self.time - start


def clocks(rng: np.random.Generator, count: int) -> tuple[ClockError, ...]:
    """Clocks with errors up to ±100 ppm, of which up to 20 ppm vary slowly; the first two at the limits."""
    rates = [80.0, -80.0, *rng.uniform(-80, 80, count - 2)]
    return tuple(ClockError(rate, rng.uniform(5, 20), rng.uniform(30, 120)) for rate in rates)


def run(ticks: int, seed: int, jitter: float, outlier: float, outliers: float, lost: float) -> None:
    rng = np.random.default_rng(seed)
    time = SimulatedTime(rng, jitter, outlier, outliers)
    faults: tuple[Fault, ...] = tuple(
        LostFrames(int(cycle)) for cycle in 1000 + np.flatnonzero(rng.random(ticks) < lost)
    )
    ring_settings = RingSettings(clocks=RingClocks(clocks(rng, 6), need_sync0=DRIVES), faults=faults)
    sensors = HopperSensorModel(
        tick=TICK, boom_length=1.854, pivot_height=0.4, motor_counts=16384, boom_counts_horizontal=5000,
        boom_counts_vertical=16384, touchdown_force=5.0, takeoff_length=0.27,
    )  # fmt: skip
    settings = emulated_settings(sensors, RobotParameters(), ring_settings, INTERFACE)
    slaves = tuple(replace(each, assign_activate=0x300 * (each.name in DRIVES)) for each in settings.slaves)
    settings = replace(settings, slaves=slaves)
    rig = EthercatRig(settings, settings.sensor_model(1.854), HostTime(time.now, time.pause))
    began = perf_counter()
    with emulated(INTERFACE, StillMachine, ring_settings, time.ring_time), rig:
        offsets, apart, fault = drive(rig, time, ticks)
    report(offsets, apart, len(faults), fault, perf_counter() - began)


def drive(rig: EthercatRig, time: ComputedTime, ticks: int) -> tuple[list[float], list[int], str]:
    """Runs ticks as the control loop does; returns offsets [s], largest differences of the drives' SYNC0 [ns], fault."""
    clock, start = TickClock(TICK), time.time
    offset = list(rig.diagnostic_units).index("clock_offset")
    offsets, apart = [], []
    try:
        for tick in range(ticks):
            clock.shift(rig.clock_correction())
            due = clock.due
            clock.begin(time.pace(due, start) - due)
            rig.read()
            time.pause(50e-6)  # the control law
            rig.write((0.0, 0.0))
            offsets.append(rig.diagnostics[offset])
            if tick % 100 == 99:
                apart.append(_apart(rig))
    except RigFault as fault:
        return offsets, apart, str(fault)
    return offsets, apart, ""


def _apart(rig: EthercatRig) -> int:
    """Difference of the system times of the two drives at the same true time [ns]; a frame takes 500 ns in between."""
    first, second = (int.from_bytes(slave._fprd(0x0910, 8), "little") for slave in rig._bus._master.slaves[:2])
    return second - first - 500


def report(offsets: list[float], apart: list[int], lost: int, fault: str, took: float) -> None:
    late = 1e6 * np.abs(offsets[1:])
    quantiles = ", ".join(f"{100 * q:g} % {np.quantile(late, q):.1f} µs" for q in (0.5, 0.99, 0.999))
    print(f"{len(offsets)} ticks in {took:.0f} s, {lost} frames lost, fault: {fault or 'none'}")
    print(
        f"frame beside its time: {quantiles}, worst {late.max():.1f} µs; after the first second {late[1000:].max():.1f} µs"
    )
    print(f"drives' clocks apart: 99.9 % {np.quantile(np.abs(apart), 0.999):.0f} ns, worst {np.abs(apart).max()} ns")


if __name__ == "__main__":
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--ticks", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jitter", type=float, default=5e-6, help="mean delay of a tick [s]")
    parser.add_argument("--outlier", type=float, default=2e-4, help="largest additional delay of a rare tick [s]")
    parser.add_argument("--outliers", type=float, default=1e-3, help="share of such ticks")
    parser.add_argument("--lost", type=float, default=0.0, help="share of lost frames")
    arguments = parser.parse_args()
    run(**vars(arguments))
