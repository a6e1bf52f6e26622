"""Faults of sensors on the hopping twin: how soon torque goes off, for which reason, and what is not detected.

Jumps: from every tick of the third hop on, an encoder is shifted; the table has the share of these ticks after which
torque is off within two ticks, for `sample_jitter` 0.1 and 1, in all of them and in the 6 ms after touchdown.

Random faults: each at a random tick of the second or third hop of a preset twin with other random numbers: an encoder
jumps (by 0.5° to 90°, uniform in the logarithm), freezes, or is noisy (5 to 50 counts); the force freezes, is zero, or
is noisy (30 to 300 N). The torque is that of the last tick before the stop. A fault counts as missed if it has not
stopped the robot after three more hops; the last column are stops of other kinds, such as a fall.

Wrong states: yaw or pitch has a wrong scale or sign from a random tick on, drifts [m/s], loses a part of its counts,
is noisy [counts] or has a stuck bit. Of each fault and size: hops that would be learned, which excludes those that the
stop taints; how many of them, after the third stance with the fault, have a measured state that differs from the true
one by more than three standard deviations of the estimate on the healthy twin; the largest errors of hops that are
learned after the third stance; runs that were stopped, and the stances with the fault until then (median, most).

    ./go python benchmarks/sensor_faults.py [--tables jumps random states] [--seed 1] [--faults 200] [--seeds 20]
        [--processes 1]
"""

import argparse
from collections import defaultdict
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from math import tau
from typing import NamedTuple

import numpy as np
from false_alarms import GAINS, ROBOT, START_COMMAND, TICK, Trouble, deployment, example_limits

from stepgap.learning.steps import TAINTED
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


class BoomFault(NamedTuple):
    """A lasting fault of an encoder of the boom.

    Attributes:
        sensor: Field of the reading.
        kind: Kind of fault.
        size: Its size, in the unit of the kind.
    """

    sensor: str
    kind: str
    size: float

    def change(self, rng: np.random.Generator) -> Change:
        """How it changes readings, from its first call on."""
        per_metre = DEGREES[self.sensor] * 360 / tau / ROBOT.boom_length
        first, last, lost, bit = 0.0, 0.0, 0.0, 1 << int(max(0.0, self.size))

        def wrong(number: int, value: float) -> float:
            nonlocal first, last, lost
            if number == 0:
                first = last = value
            moved, last = value - last, value
            lost += np.sign(moved) * rng.binomial(round(abs(moved)), self.size) if self.kind == "lost part" else 0.0
            return {
                "scale": lambda: first + self.size * (value - first),
                "drift": lambda: value + self.size * TICK * number * per_metre,
                "lost part": lambda: value - lost,
                "noise": lambda: value + self.size * rng.standard_normal(),
                "bit stuck at 0": lambda: round(value) & ~bit,
                "bit stuck at 1": lambda: round(value) | bit,
            }[self.kind]()

        return lambda number, reading: reading._replace(
            **{self.sensor: float(round(wrong(number, getattr(reading, self.sensor))))}
        )


def boom_faults() -> list[BoomFault]:
    """The faults of the table."""
    sizes = {
        "scale": (0.5, 0.8, 0.9, 1.1, 1.25, 2.0, -1.0, 0.0),
        "drift": (0.02, -0.02, 0.05, -0.05, 0.5, -0.5),
        "lost part": (0.1, 0.3),
        "noise": (1.0, 2.0, 5.0),
        "bit stuck at 0": (0, 1, 2, 3, 4),
        "bit stuck at 1": (0, 1, 2, 3, 4),
    }
    sensors = ("boom_horizontal", "boom_vertical")
    return [BoomFault(sensor, kind, size) for sensor in sensors for kind in sizes for size in sizes[kind]]


class Hops(NamedTuple):
    """Hops of a run.

    Attributes:
        stances: Number of stances with the fault before the end of each; shape (h,).
        error: Measured − true state at the end of each, speed [m/s] and height [m]; shape (h, 2).
        ended_after: Number of stances with the fault until the robot was stopped; NaN if it was not.
        reason: Why it was stopped.
        tainted: Number of the last hops that are not learned.
    """

    stances: np.ndarray
    error: np.ndarray
    ended_after: float
    reason: str
    tainted: int


def hops_of(fault: BoomFault | None, seed: int, most: int = 40) -> Hops:
    """Hops of the twin with a fault from a random tick on; without one, all of them."""
    rng = np.random.default_rng(seed)
    twin, begin = Twin(ROBOT, RealityGap(), rng), int(rng.uniform(1500, 3000))
    change, stances, found, before = fault.change(rng) if fault else None, 0, [], Phase.DESCENT
    wrong: Change = lambda n, reading: change(n - begin, reading) if change and n >= begin else reading  # noqa: E731
    for number, (control, flags, _, _) in enumerate(deployment(twin, example_limits(), rng, Trouble(), wrong)):
        phase = int(control.memory[1]["phase"][0])
        stances, before = stances + int(number > begin and before == Phase.THRUST != phase), phase
        if flags & TickFlag.STEP_ENDED and (number > begin or not fault):
            apex = control.state.apex
            found.append((stances, apex.speed - twin.truth[0], apex.height - twin.truth[1]))
        ended = flags & (TickFlag.STOPPED | TickFlag.FAILED) != 0
        if ended or len(found) == most:
            hops = np.array(found).reshape(-1, 3)
            reason = control.stopped.split(" (")[0] or control.status.label if ended else ""
            tainted = TAINTED.get(control.status, 0) if ended else 0
            return Hops(hops[:, 0], hops[:, 1:], stances if ended else np.nan, reason, tainted)
    raise AssertionError("a deployment ends only when the robot is stopped")


def print_wrong_states(seeds: int, processes: int) -> None:
    """Prints a line for each fault of yaw and pitch."""
    with ProcessPoolExecutor(processes) as pool:
        healthy = np.vstack([hops.error for hops in pool.map(hops_of, [None] * seeds, range(seeds))])
        mean, std = healthy.mean(axis=0), healthy.std(axis=0, ddof=1)
        print(f"estimate on the healthy twin: mean ± std {1e3 * mean.round(6)} ± {1e3 * std.round(6)} mm/s, mm")
        total = 0
        for fault in boom_faults():
            runs = list(pool.map(hops_of, [fault] * seeds, range(seeds)))
            learned = [run.error[: max(0, len(run.error) - run.tainted)] for run in runs]
            late = [np.abs(error[run.stances[: len(error)] > 3]) for run, error in zip(runs, learned, strict=True)]
            errors = np.vstack([*late, np.zeros((1, 2))])
            wrong = int((np.abs(errors - mean) > 3 * std).any(axis=1)[:-1].sum())
            total += wrong
            after = [run.ended_after for run in runs if run.reason] or [np.nan]
            stopped, reasons = sum(bool(run.reason) for run in runs), sorted({run.reason for run in runs if run.reason})
            print(
                f"  {fault.sensor:15s} {fault.kind:14s} {fault.size:5g}  learned {sum(map(len, learned)):3d}, wrong "
                f"{wrong:2d} ({errors[:, 0].max():.3f} m/s, {1e3 * errors[:, 1].max():.1f} mm)  stopped "
                f"{stopped} of {seeds}, stances {np.median(after):.0f}, {max(after):.0f}: {'; '.join(reasons)}",
                flush=True,
            )
    print(f"  all: {total} hops learned whose state is wrong")


def main() -> None:
    """Prints the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", nargs="+", default=["jumps", "random", "states"])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--faults", type=int, default=200)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    if "jumps" in options.tables:
        for jitter in (0.1, 1.0):
            print_jumps(jitter)
    if "random" in options.tables:
        print_random_faults(options.seed, options.faults)
    if "states" in options.tables:
        print_wrong_states(options.seeds, options.processes)


if __name__ == "__main__":
    main()
