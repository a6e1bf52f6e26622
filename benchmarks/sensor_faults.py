"""Faults of sensors on the hopping twin: how soon torque goes off, for which reason, and what is not detected.

Jumps: from every tick of the third hop on, an encoder is shifted; the table has the share of these ticks after which
torque is off within two ticks, for `sample_jitter` 0.1 and 1, in all of them and in the 6 ms after touchdown.

Random faults: each at a random tick of the second or third hop of a preset twin with other random numbers: an encoder
jumps (by 0.5° to 90°, uniform in the logarithm), freezes, or is noisy (5 to 50 counts); the force freezes, is zero, or
is noisy (30 to 300 N). The torque is that of the last tick before the stop. A fault counts as missed if it has not
stopped the robot after three more hops; the last column are stops of other kinds, such as a fall.

    ./go python benchmarks/sensor_faults.py [--seed 1] [--faults 200]
"""

import argparse
from collections import defaultdict
from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from false_alarms import GAINS, ROBOT, START_COMMAND, TICK, Trouble, deployment, example_limits

from stepgap.plants.tick_control import Mode, Order, TickFlag
from stepgap.robots.hopper.tick.hop_control import HopControl
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.phases import Phase
from stepgap.robots.hopper.tick.safety import DOUBTS, Limited
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin

DEGREES = {"motor_1": 16384 / 360, "motor_2": 16384 / 360, "boom_horizontal": 5000 / 360, "boom_vertical": 16384 / 360}
"""Counts per degree of each encoder."""
SIZES = (0.3, 0.5, 0.9, 1.0, 2.0, 5.0)
"""Sizes of the jumps in the table [°]."""
SOON, TOUCHDOWN = 2, 6
"""Ticks within which a jump counts as detected, and after touchdown that are counted on their own."""

Reading = HopperReading
Change = Callable[[int, Reading], Reading]


class Tick(NamedTuple):
    """A tick of a recording: reading, torques before, phase, and the state of the control before it."""

    reading: Reading
    applied: tuple[float, float]
    phase: int
    before: np.ndarray


def recorded_hop(limits: SafetyLimits) -> tuple[HopControl, list[Tick]]:
    """Control and ticks of the third hop, with three more that follow it."""
    twin, ticks, hops, more = Twin(ROBOT, RealityGap(), np.random.default_rng(0)), [], 0, 3
    twin.connect()
    control, applied, time = HopControl(twin.sensor_model, ROBOT, GAINS, limits), (0.0, 0.0), 0.0
    while more:
        reading, before = twin.read(), control.memory[1].copy()
        torques, flags = control.tick(time, reading, Order(Mode.STEP, 1.0, START_COMMAND), applied)
        hops += int(flags & TickFlag.STEP_ENDED != 0)
        if hops >= 2:
            ticks.append(Tick(reading, applied, control.state.phase, before))
        more -= hops >= 3
        applied, time = twin.write(torques), time + TICK
    return control, ticks


def is_detected(control: HopControl, ticks: list[Tick], sensor: str, counts: float) -> bool:
    """Whether a shift from the first of three ticks on stops the robot in one of them."""
    control.memory[1][:] = ticks[0].before
    time, flags = float(ticks[0].before["sampled"][0]), 0
    for tick in ticks:
        time += TICK
        shifted = tick.reading._replace(**{sensor: round(getattr(tick.reading, sensor) + counts)})
        flags |= control.tick(time, shifted, Order(Mode.STEP, 1.0, START_COMMAND), tick.applied)[1]
    return bool(flags & TickFlag.STOPPED)


def print_jumps(jitter: float) -> None:
    """Prints the shares of ticks in which jumps are detected: all ticks, and just after touchdown."""
    control, ticks = recorded_hop(replace(example_limits(), sample_jitter=jitter))
    last = len(ticks) - SOON
    down = next(n for n, tick in enumerate(ticks) if tick.phase == Phase.COMPRESSION)
    print(f"sample_jitter {jitter:g}, {last} ticks, of which {TOUCHDOWN} after touchdown; detected [%], all / these")
    for sensor, unit in DEGREES.items():
        cells = []
        for size in SIZES:
            found = np.array(
                [
                    [is_detected(control, ticks[n : n + SOON + 1], sensor, sign * size * unit) for sign in (1, -1)]
                    for n in range(last)
                ]
            )
            cells.append(f"{size:g}°: {100 * found.mean():.1f} / {100 * found[down : down + TOUCHDOWN].mean():.0f}")
        print(f"  {sensor:16s} " + "   ".join(cells), flush=True)


def random_fault(rng: np.random.Generator) -> tuple[str, Change]:
    """Name of a random kind of fault, and how it changes a reading; the reading of its first call may be kept."""
    sensor = str(rng.choice([*DEGREES, "contact_force"]))
    kind, kept = str(rng.choice(["jump", "freeze", "noise"])), []
    noise = np.exp(rng.uniform(*np.log([30.0, 300.0] if sensor == "contact_force" else [5.0, 50.0])))
    jump = DEGREES.get(sensor, 0.0) * np.exp(rng.uniform(*np.log([0.5, 90.0]))) * rng.choice([-1, 1])

    def wrong(value: float) -> float:
        kept.append(value)
        if kind == "freeze":
            return kept[0]
        if sensor == "contact_force":
            return 0.0 if kind == "jump" else value + noise * rng.standard_normal()
        return float(round(value + (jump if kind == "jump" else noise * rng.standard_normal())))

    name = "zero" if sensor == "contact_force" and kind == "jump" else kind
    return f"{sensor} {name}", lambda _, reading: reading._replace(**{sensor: wrong(getattr(reading, sensor))})


class Outcome(NamedTuple):
    """What became of a fault.

    Attributes:
        ticks: Ticks from the fault to the stop; NaN where nothing stopped the robot.
        torque: Largest torque in these ticks [N·m].
        doubted: Whether a doubtful sensor was the reason.
        reason: The reason.
    """

    ticks: float
    torque: float
    doubted: bool
    reason: str


def outcome_of(rng: np.random.Generator) -> tuple[str, Outcome]:
    """Kind and outcome of a random fault."""
    twin, limits = Twin(ROBOT, RealityGap(), rng), example_limits()
    begin, torque = int(rng.uniform(1500, 2900)), 0.0
    kind, fault = random_fault(rng)
    ended = 0
    change: Change = lambda n, reading: fault(n, reading) if n >= begin else reading  # noqa: E731
    for number, (control, flags, applied, _) in enumerate(deployment(twin, limits, rng, Trouble(), change)):
        if number > begin:
            torque, ended = max(torque, *map(abs, applied)), ended + int(flags & TickFlag.STEP_ENDED != 0)
        if flags & (TickFlag.STOPPED | TickFlag.FAILED):
            reason = control.stopped.split(" (")[0] or control.status.label
            doubted = Limited(control.state.watch.stopped) & DOUBTS != 0
            return kind, Outcome(number - begin, torque, doubted, reason)
        if ended > 3:
            break
    return kind, Outcome(np.nan, torque, False, "missed")


def print_random_faults(seed: int, number: int) -> None:
    """Prints a line for each kind of fault."""
    found = defaultdict(list)
    for child in np.random.SeedSequence(seed).spawn(number):
        kind, outcome = outcome_of(np.random.default_rng(child))
        found[kind].append(outcome)
    print(f"{number} random faults, seed {seed}: stopped by a doubt, ticks (median, 90 %, worst), torque, other ends")
    for kind, outcomes in sorted(found.items()):
        doubted = [outcome for outcome in outcomes if outcome.doubted]
        ticks = [outcome.ticks for outcome in doubted] or [np.nan]
        others = [f"{o.reason} ({o.ticks:.0f})" for o in outcomes if not o.doubted]
        spread = " ".join(f"{value:6.0f}" for value in (*np.quantile(ticks, [0.5, 0.9]), max(ticks)))
        torque = max((outcome.torque for outcome in doubted), default=np.nan)
        print(f"  {kind:24s} {len(doubted):3d} of {len(outcomes):3d} {spread} {torque:6.1f} N·m  {', '.join(others)}")
    every = [outcome for outcomes in found.values() for outcome in outcomes]
    print(f"  all: {sum(o.doubted for o in every)} of {number} doubted, {sum(o.ticks >= 0 for o in every)} stopped")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=200)
    options = parser.parse_args()
    for jitter in (0.1, 1.0):
        print_jumps(jitter)
    print_random_faults(options.seed, options.faults)


if __name__ == "__main__":
    main()
