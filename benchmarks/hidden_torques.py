"""Drives that report the command and give another torque: when the control tick stops the robot, at which speed.

The twin hops with random commands under the limits of `examples/rig.toml`. From a random tick of the third to sixth
hop on, one drive or both give another torque than they report. Of each fault, over some twins of the family: how many
were stopped, ticks from the first torque that differs from the command by more than 1 N·m (median, most), joint speed
at the stop (median, most), and which drives were named. Twins that reach 50 rad/s without a fault, since their control
loop is not stable with their drives, are left out. Healthy twins then hop with lost frames and late ticks, and no stop
may be due to a drive; those whose torque is suddenly scaled by 0.85, too.

    ./go python benchmarks/hidden_torques.py [--twins 90000-90005] [--healthy 500-507] [--hops 250]
"""

import argparse
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import replace
from math import inf

import numpy as np
from false_alarms import DEPLOYMENTS, JOINT_SPEED, OTHER_LIMITS, ROBOT, Trouble, deployment, example_limits

from stepgap.plants.tick_control import TickFlag
from stepgap.rigs.rig import Reading, Rig, RigFault, Torques
from stepgap.robots.hopper.tick.safety import DISOBEYS, Limited
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

WRONG = 1.0
"""Difference from the command from which a torque counts as wrong [N·m]."""
WATCHED = 2500
"""Ticks after the first wrong torque for which a stop is waited for."""
LATE = 3
"""Ticks by which a late torque comes later."""
VIBRATES = 50.0
"""Joint speed that a healthy twin does not reach [rad/s]."""

Law = Callable[[float, int], float]
"""Torque that a drive gives for a command, in a tick since the fault began [N·m]."""

FAULTS: dict[str, Callable[[], Law]] = {
    "inverted": lambda: lambda torque, tick: -torque,
    "−38 N·m": lambda: lambda torque, tick: -38.0,
    "+10 N·m": lambda: lambda torque, tick: torque + 10.0,
    "dead": lambda: lambda torque, tick: 0.0,
    "3 ms late": lambda: Late(),
    "× 2": lambda: lambda torque, tick: 2.0 * torque,
    "× 0.5": lambda: lambda torque, tick: 0.5 * torque,
    "× 0.7": lambda: lambda torque, tick: 0.7 * torque,
    "saturated at 6 N·m": lambda: lambda torque, tick: min(max(torque, -6.0), 6.0),
    "off 20 of 300 ms": lambda: lambda torque, tick: 0.0 if tick % 300 < 20 else torque,
}


class Late:
    """A drive whose torque comes `LATE` ticks later."""

    def __init__(self) -> None:
        self._sent = deque[float](maxlen=LATE + 1)

    def __call__(self, torque: float, _: int) -> float:
        """The torque of the command some ticks before."""
        self._sent.append(torque)
        return self._sent[0] if len(self._sent) > LATE else torque


class HidingDrives(Rig):
    """The twin behind drives that report their commands.

    Args:
        twin: The robot.
        laws: What each drive gives; None for a healthy drive.
        begin: Tick in which the fault begins.
    """

    def __init__(self, twin: Twin, laws: Sequence[Law | None], begin: int):
        self._twin = twin
        self._laws = laws
        self._begin = begin
        self._most = example_limits().torque
        self.ticks = 0
        self.wrong_since = -1

    @property
    def sensor_model(self) -> HopperSensorModel:
        """That of the twin."""
        return self._twin.sensor_model

    def connect(self) -> None:
        """Connects the twin."""
        self._twin.connect()

    def close(self) -> None:
        """Switches torque off."""
        self._twin.close()

    def read(self) -> Reading:
        """The twin's reading."""
        return self._twin.read()

    def write(self, torques: Torques) -> Torques:
        """Commands torques, and returns them although the drives may give others."""
        sent = tuple(min(max(torque, -self._most), self._most) for torque in torques)
        given = sent
        if self.ticks >= self._begin:
            since = self.ticks - self._begin
            given = tuple(law(torque, since) if law else torque for law, torque in zip(self._laws, sent, strict=True))
        differs = max(abs(torque - command) for torque, command in zip(given, sent, strict=True)) > WRONG
        if differs and self.wrong_since < 0:
            self.wrong_since = self.ticks
        self.ticks += 1
        self._twin.write(given)
        return sent


def limits_of_drives():
    """Limits of the example of which only torques, joint speed, sensors and drives are judged."""
    return replace(example_limits(), **dict.fromkeys(OTHER_LIMITS, inf), shortest_leg=0.0, lowest_hip=-inf)


def outcome_of(seed: int, make: Callable[[], Law], both: bool) -> tuple[float, float, str]:
    """Ticks until the stop and joint speed then, NaN without one, and its reason; empty reason without a stop."""
    rng = np.random.default_rng(seed)
    twin = Twin(ROBOT, RealityGap.random(rng), rng)
    broken = int(rng.integers(2))
    laws = tuple(make() if both or motor == broken else None for motor in range(2))
    rig = HidingDrives(twin, laws, int(rng.uniform(3000, 4500)))
    speed = 0.0
    try:
        for control, flags, _, _ in deployment(rig, limits_of_drives(), rng, Trouble()):
            speed = float(control.memory[2][JOINT_SPEED])
            since = rig.ticks - rig.wrong_since
            if rig.wrong_since < 0 and speed > VIBRATES:
                return np.nan, np.nan, "before: it vibrates"
            if flags & (TickFlag.STOPPED | TickFlag.FAILED):
                reason = control.stopped.split(" (")[0] or control.status.label
                return (since, speed, reason) if rig.wrong_since >= 0 else (np.nan, np.nan, f"before: {reason}")
            if rig.wrong_since >= 0 and since > WATCHED:
                break
    except RigFault as fault:
        return rig.ticks - rig.wrong_since, speed, str(fault)
    return np.nan, np.nan, ""


def print_faults(twins: range) -> None:
    """Prints a line for each fault."""
    print(f"| fault, {len(twins)} twins each | stopped | ticks: median, most | rad/s: median, most | reasons |")
    print("|---|---|---|---|---|")
    for name, make in FAULTS.items():
        for both in (False, True):
            outcomes = [outcome_of(seed, make, both) for seed in twins]
            hopped = [outcome for outcome in outcomes if not outcome[2].startswith("before")]
            stopped = [outcome for outcome in hopped if outcome[2]]
            ticks, speeds = (np.array([outcome[column] for outcome in stopped] or [np.nan]) for column in (0, 1))
            reasons = Counter(outcome[2] for outcome in stopped)
            print(
                f"| {'both' if both else 'one'} {name} | {len(stopped)} of {len(hopped)} "
                f"| {np.median(ticks):.0f}, {ticks.max():.0f} | {np.median(speeds):.0f}, {speeds.max():.0f} "
                f"| {', '.join(f'{count} × {reason}' for reason, count in reasons.most_common())} |",
                flush=True,
            )


def healthy_row(seed: int, hops: int, trouble: Trouble, scale: float) -> tuple[int, Counter[str], int]:
    """Hops of a healthy twin, reasons of its stops, and how many of these doubt a drive.

    The torque of both drives changes to a part `scale` of it in the tenth second of a deployment.
    """
    rng = np.random.default_rng(seed)
    twin = Twin(ROBOT, RealityGap.random(rng), rng)
    laws = (lambda torque, tick: scale * torque,) * 2
    made, doubted, stops = 0, 0, Counter[str]()
    for _ in range(DEPLOYMENTS):
        try:
            for control, flags, _, _ in deployment(HidingDrives(twin, laws, 10_000), limits_of_drives(), rng, trouble):
                made += int(flags & TickFlag.STEP_ENDED != 0)
                if flags & (TickFlag.STOPPED | TickFlag.FAILED):
                    stops[control.stopped.split(" (")[0] or control.status.label] += 1
                    doubted += bool(Limited(int(control.memory[1]["watch"]["stopped"][0])) & DISOBEYS)
                if made == hops:
                    return made, stops, doubted
        except RigFault as fault:
            stops[str(fault)] += 1
    return made, stops, doubted


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", default="90000-90005")
    parser.add_argument("--healthy", default="500-507")
    parser.add_argument("--hops", type=int, default=250)
    parser.add_argument("--lost", type=float, default=0.05)
    options = parser.parse_args()
    first, last = map(int, options.twins.split("-"))
    print_faults(range(first, last + 1))
    first, last = map(int, options.healthy.split("-"))
    total = alarms = 0
    for scale in (1.0, 0.85):
        for seed in range(first, last + 1):
            made, stops, doubted = healthy_row(seed, options.hops, Trouble(options.lost, options.lost / 10), scale)
            print(f"torque × {scale}, twin {seed}: {made} hops, stops {dict(stops) or '–'}", flush=True)
            total += made
            alarms += doubted
    print(f"{alarms} stops by drives in {total} hops")


if __name__ == "__main__":
    main()
