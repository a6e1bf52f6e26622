"""Faults of drives under the hopping twin: how soon torque is off, for which reason, and how far it got until then.

The emulated drives move the twin tick by tick, with their watch and the safety function as on the bus, but without
frames. From a random tick of the second to fourth hop on, a drive gives another torque than commanded, reports it or
hides it, hangs, or sets bits of its status word. Of each fault: ticks from the first torque that differs from the
command by more than 1 N·m to the commanded end of torque (median, most), the largest torque that the motor gave and the
largest joint speed until then, and the reasons. A drive that hangs keeps its torque: only STO ends it.

Healthy twins of the family hop with lost frames and late ticks; no stop may be due to a drive.

    ./go python benchmarks/actuator_faults.py [--seeds 20] [--healthy 100-109] [--hops 227] [--lost 0.05]
        [--processes 1]
"""

import argparse
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from math import inf
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from false_alarms import DEPLOYMENTS, JOINT_SPEED, OTHER_LIMITS, ROBOT, Trouble, deployment, example_limits

from stepgap.hardware.ethercat.drive_watch import DriveWatch
from stepgap.hardware.ethercat.emulator.drive import CONTROLWORD, MODE, TARGET_TORQUE, Drive, DriveSettings
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.pdo import SIGNED_VALUES
from stepgap.hardware.hopper.ring_rig import emulated_settings
from stepgap.plants.tick_control import TickFlag
from stepgap.rigs.rig import Rig, RigFault, Torques
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

WRONG = 1.0
"""Difference from the command from which a torque counts as wrong [N·m]."""
ENABLING = (0x06, 0x07, 0x0F)
"""Controlwords until a drive is enabled."""
RING = RingSettings()

FAULTS: dict[str, Fault] = {
    "runs away, +38 N·m": Fault("wrong torque", 0, "drive", offset=2375),
    "runs away, −38 N·m": Fault("wrong torque", 0, "drive", offset=-2375),
    "runs away, +10 N·m": Fault("wrong torque", 0, "drive", offset=625),
    "runs away, hidden": Fault("wrong torque", 0, "drive", offset=2375, is_reported=False),
    "wrong sign": Fault("wrong torque", 0, "drive", factor=-1.0),
    "wrong sign, hidden": Fault("wrong torque", 0, "drive", factor=-1.0, is_reported=False),
    "twice the torque": Fault("wrong torque", 0, "drive", factor=2.0),
    "half the torque": Fault("wrong torque", 0, "drive", factor=0.5),
    "dead": Fault("wrong torque", 0, "drive"),
    "dead, hidden": Fault("wrong torque", 0, "drive", is_reported=False),
    "keeps its torque": Fault("wrong torque", 0, "drive", is_kept=True),
    "hangs": Fault("stalled", 0, "drive", cycles=10**6),
    "ignores commands (bit 12)": Fault("status bits", 0, "drive", cleared=0x1000),
    "internal limit (bit 11)": Fault("status bits", 0, "drive", raised=0x0800),
    "warning (bit 7)": Fault("status bits", 0, "drive", raised=0x0080),
    "torque 3 ms later": Fault("delayed", 0, "drive", torque=3),
    "torque 6 ms later": Fault("delayed", 0, "drive", torque=6),
    "encoder 3 ms later": Fault("delayed", 0, "drive", counts=3),
}


class DriveRig(Rig):
    """The twin behind two emulated drives and their watches.

    Args:
        twin: The robot.
        fault: Fault of a drive, and its number; None if both are healthy.
        begin: Tick in which it begins.
    """

    def __init__(self, twin: Twin, fault: tuple[int, Fault] | None = None, begin: int = 0):
        self._twin, self._fault, self._begin = twin, fault, begin
        settings = emulated_settings(twin.sensor_model, ROBOT, RING)
        self._motors = tuple(replace(motor, bus_voltage=()) for motor in (settings.motor_1, settings.motor_2))
        self._settings = settings
        self.landing = ""

    @property
    def sensor_model(self) -> HopperSensorModel:
        """That of the twin."""
        return self._twin.sensor_model

    def close(self) -> None:
        """Switches torque off."""
        self._twin.close()

    @property
    def truth(self) -> Torques:
        """True state at the apex."""
        return self._twin.truth

    def connect(self) -> None:
        """Connects the twin and enables the drives."""
        self._twin.connect()
        drive = DriveSettings(rated_torque=RING.rated_torque, largest_torque=RING.largest_torque)
        names, settings = ("motor_1", "motor_2"), self._settings
        self._drives = [Drive(name, drive, attrgetter(name)) for name in names]
        entries = [settings.input_entries(motor.slave) for motor in self._motors]
        self._watches = [DriveWatch(*each, 1e-3) for each in zip(names, self._motors, entries, strict=True)]
        self._entries, self.ticks, self.given, self.wrong_since = entries, 0, (0.0, 0.0), -1
        self._reading, self._commanded = self._twin.read(), (0.0, 0.0)
        for drive in self._drives:
            drive.sense(self._reading)
        for controlword in ENABLING:
            self._act(controlword, (0, 0))

    def read(self) -> HopperReading:
        """The reading, after the watches have judged the drives.

        Raises:
            RigFault: A drive is at fault.
        """
        for watch, inputs in zip(self._watches, self._inputs(), strict=True):
            if excess := watch.update(inputs):
                raise RigFault(excess)
            self.landing = self.landing or watch.warning
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Commands torques for a tick and returns them as they were sent."""
        unit = self._motors[0].torque_unit
        most = self._motors[0].most_units
        units = [round(min(max(torque / unit, -most), most)) for torque in torques]
        if self._fault and self.ticks == self._begin and self._fault[1].kind != "stalled":
            self._drives[self._fault[0]].begin(self._fault[1])
        for watch, count in zip(self._watches, units, strict=True):
            watch.command(count)
        self._commanded = (units[0] * unit, units[1] * unit)
        self._act(ENABLING[-1], units)
        self.given = tuple(drive.torque for drive in self._drives)
        differs = max(abs(given - sent) for given, sent in zip(self.given, self._commanded, strict=True)) > WRONG
        if self._fault and self.ticks >= self._begin and differs and self.wrong_since < 0:
            self.wrong_since = self.ticks
        self._twin.write(self.given)
        self._reading = self._twin.read()
        for number, drive in enumerate(self._drives):
            if not self._hangs(number):
                drive.sense(self._reading)
        motor_1, motor_2 = (inputs["position"] for inputs in self._inputs())
        self._reading = self._reading._replace(motor_1=motor_1, motor_2=motor_2)
        self.ticks += 1
        return self._commanded

    def _hangs(self, number: int) -> bool:
        fault = self._fault
        return bool(fault and fault[1].kind == "stalled" and fault[0] == number and self.ticks >= self._begin)

    def _act(self, controlword: int, units: Sequence[int]) -> None:
        for number, (drive, count) in enumerate(zip(self._drives, units, strict=True)):
            if not self._hangs(number):
                for index, value, size in ((CONTROLWORD, controlword, 2), (MODE, 10, 1), (TARGET_TORQUE, count, 2)):
                    drive.dictionary.write(index, 0, value.to_bytes(size, "little", signed=value < 0), may_assign=False)
                drive.update(operational=True)

    def _inputs(self) -> list[dict[str, int]]:
        """Values of the inputs of each drive."""
        return [
            {
                name: int.from_bytes(drive.dictionary.read(entry.index, 0), "little", signed=SIGNED_VALUES[name])
                for name, entry in entries.items()
            }
            for drive, entries in zip(self._drives, self._entries, strict=True)
        ]


class Outcome(NamedTuple):
    """What became of a fault.

    Attributes:
        ticks: Ticks from the first wrong torque to the end of torque; NaN without a stop or a wrong torque.
        torque: Largest torque given since the fault began [N·m].
        speed: Largest joint speed since then [rad/s].
        reason: Why torque ended; empty if it did not within 3 s.
    """

    ticks: float
    torque: float
    speed: float
    reason: str


def outcome_of(fault: Fault, seed: int) -> Outcome:
    """Outcome of a fault of a random drive from a random tick on."""
    rng = np.random.default_rng(seed)
    begin, number = int(rng.uniform(1500, 3500)), int(rng.integers(2))
    rig = DriveRig(Twin(ROBOT, RealityGap(), rng), (number, fault), begin)
    torque = speed = 0.0
    reason = ""
    try:
        for control, flags, _, _ in deployment(rig, example_limits(), rng, Trouble()):
            if rig.ticks > begin:
                torque = max(torque, *map(abs, rig.given))
                speed = max(speed, float(control.memory[2][JOINT_SPEED]))
            if flags & (TickFlag.STOPPED | TickFlag.FAILED) or rig.landing:
                reason = rig.landing or control.stopped.split(" (")[0] or control.status.label
                break
            if rig.ticks > begin + 3000:
                break
    except RigFault as error:
        reason = str(error)
    wrong = rig.wrong_since
    torque = max(torque, *map(abs, rig.given))
    return Outcome(rig.ticks - wrong if reason and wrong >= 0 else np.nan, torque, speed, reason)


def print_faults(seeds: int, processes: int) -> None:
    """Prints a line for each fault."""
    print(f"{seeds} deployments each: ticks from the first wrong torque until it ends (median, most), torque, speed")
    with ProcessPoolExecutor(processes) as pool:
        for name, fault in FAULTS.items():
            outcomes = list(pool.map(partial(outcome_of, fault), range(seeds)))
            ticks = [each.ticks for each in outcomes if each.ticks == each.ticks] or [np.nan]
            stopped = sum(bool(each.reason) for each in outcomes)
            reasons = Counter(_kind(each.reason) for each in outcomes if each.reason)
            print(
                f"  {name:26s} {stopped:3d} stopped  {np.median(ticks):3.0f} {max(ticks):3.0f} ticks "
                f"{max(each.torque for each in outcomes):5.1f} N·m {max(each.speed for each in outcomes):4.0f} rad/s  "
                + ", ".join(f"{count} × {reason}" for reason, count in reasons.most_common()),
                flush=True,
            )


def _kind(reason: str) -> str:
    """A reason without its numbers."""
    for words, kind in (
        ("its torque is", "torque"),
        ("ignores", "bit 12"),
        ("hangs", "hangs"),
        ("limit (bit", "bit 11"),
    ):
        if words in reason:
            return kind
    return "bit 7" if "warns" in reason else reason


def healthy_row(trouble: Trouble, hops: int, seed: int) -> tuple[int, Counter[str]]:
    """Hops of a healthy twin, and the reasons of its stops."""
    rng = np.random.default_rng(seed)
    rig, made, stops = DriveRig(Twin(ROBOT, RealityGap.random(rng), rng)), 0, Counter[str]()
    limits = replace(example_limits(), **dict.fromkeys(OTHER_LIMITS, inf), shortest_leg=0.0, lowest_hip=-inf)
    for _ in range(DEPLOYMENTS):
        try:
            for control, flags, _, _ in deployment(rig, limits, rng, trouble):
                made += int(flags & TickFlag.STEP_ENDED != 0)
                if flags & (TickFlag.STOPPED | TickFlag.FAILED):
                    stops[control.stopped.split(" (")[0] or control.status.label] += 1
                if made == hops or rig.landing:
                    break
        except RigFault as fault:
            stops[f"DRIVE: {fault}"] += 1
        if rig.landing:
            stops[f"DRIVE: {rig.landing}"] += 1
            rig.landing = ""
        if made == hops:
            break
    return made, stops


def print_healthy(seeds: range, hops: int, trouble: Trouble, processes: int) -> None:
    """Prints a line for each healthy twin, and the number of stops by drives."""
    alarms = total = 0
    with ProcessPoolExecutor(processes) as pool:
        for seed, (made, stops) in zip(seeds, pool.map(partial(healthy_row, trouble, hops), seeds), strict=True):
            print(f"  twin {seed}: {made} hops  {dict(stops) or '–'}", flush=True)
            alarms, total = alarms + sum(n for why, n in stops.items() if why.startswith("DRIVE")), total + made
    print(f"  {alarms} stops by drives in {total} hops")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--healthy", default="100-109")
    parser.add_argument("--hops", type=int, default=227)
    parser.add_argument("--lost", type=float, default=0.05)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    print_faults(options.seeds, options.processes)
    if options.hops:
        first, last = map(int, options.healthy.split("-"))
        print_healthy(range(first, last + 1), options.hops, Trouble(options.lost, options.lost / 10), options.processes)


if __name__ == "__main__":
    main()
