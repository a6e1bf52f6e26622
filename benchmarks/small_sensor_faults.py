"""Yaw or pitch that is wrong by little, with a mean of zero, or for a short time: how many wrong hops would be learned.

Each fault begins at a random tick of the second or third hop of a twin of the family, which makes 48 hops with random
commands, and lasts. Of each fault: hops that would be learned, without those that a doubt about a sensor taints; how
many of them have a measured state that is wrong by more than 10 mm/s or 3 mm; the largest errors of the hops that would
be learned; runs that were stopped by a doubt. In some lines a run is made of deployments of 12 hops, or on measured
ramps, or the fault begins between the first deployment and the second.

    ./go python benchmarks/small_sensor_faults.py [--seeds 9000-9003] [--faults backlash …] [--processes 1]
"""

import argparse
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import product
from math import inf, radians, sin, tau
from typing import NamedTuple

import numpy as np
from false_alarms import OTHER_LIMITS, ROBOT, Trouble, deployment, example_limits

from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.tick_control import TickFlag
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.safety import DOUBTS, Limited
from stepgap.robots.hopper.tick.sensors import HopperReading
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import StepRecord, StepStatus

YAW, PITCH = "boom_horizontal", "boom_vertical"
TURN = {YAW: 5000, PITCH: 16384}
"""Counts of a turn."""
HOPS, SHORT = 48, 12
"""Hops of a run, and of each of its deployments in some lines."""
RAMPS = UnevenGround(slope=0.1)
WRONG_SPEED, WRONG_HEIGHT = 0.01, 0.003
"""Errors from which a state is wrong [m/s, m]."""

Wrong = Callable[[int, float], float]
"""The reading of a sensor [counts] after a number of ticks with a fault, for the right one."""


def scaled(factor: float) -> Wrong:
    """A scale that is wrong about the first reading."""
    first = list[float]()

    def wrong(_: int, value: float) -> float:
        first.append(value)
        return first[0] + factor * (value - first[0])

    return wrong


def walking(counts: int, rng: np.random.Generator) -> Wrong:
    """Counts that are lost or counted twice at random, in one of twenty ticks."""
    lost = 0.0

    def wrong(_: int, value: float) -> float:
        nonlocal lost
        lost += counts * float(rng.choice((-1, 1))) * float(rng.random() < 0.05)
        return value + lost

    return wrong


def dragged(ticks: int, every: int, catches_up: bool) -> Wrong:
    """A slip ring that turns at half speed for some ticks of each period; then it is where it should be, or stays."""
    last, lag = 0.0, 0.0

    def wrong(number: int, value: float) -> float:
        nonlocal last, lag
        drags = number % every < ticks
        lag += (value - last) / 2 if drags and number else 0.0
        lag = 0.0 if catches_up and not drags else lag
        last = value
        return value - lag

    return wrong


def slack(counts: float) -> Wrong:
    """Backlash of a gear."""
    shown = None

    def wrong(_: int, value: float) -> float:
        nonlocal shown
        shown = value if shown is None else min(max(shown, value - counts / 2), value + counts / 2)
        return shown

    return wrong


def eccentric(degrees: float, turn: int) -> Wrong:
    """A disk whose centre is not on its axis."""
    return lambda _, value: value + radians(degrees) * turn / tau * sin(value * tau / turn)


def shifted(degrees: float, turn: int) -> Wrong:
    """A wrong zero."""
    return lambda _, value: value + degrees * turn / 360


class Fault(NamedTuple):
    """A fault and the run in which it occurs.

    Attributes:
        sensor: Field of the reading.
        make: Makes the fault from a random generator.
        ground: Ground.
        length: Hops of a deployment.
        between: Whether the fault begins with the second deployment.
    """

    sensor: str
    make: Callable[[np.random.Generator], Wrong]
    ground: UnevenGround = FLAT_GROUND
    length: int = HOPS
    between: bool = False


FAULTS = {
    "yaw: ±2 counts at random": Fault(YAW, partial(walking, 2)),
    "yaw: slip ring drags 100 of 1500 ms": Fault(YAW, lambda _: dragged(100, 1500, True)),
    "yaw: the same, does not catch up": Fault(YAW, lambda _: dragged(100, 1500, False)),
    "yaw: eccentric by 1°": Fault(YAW, lambda _: eccentric(1.0, TURN[YAW])),
    "yaw: backlash of 6 counts": Fault(YAW, lambda _: slack(6.0)),
    "yaw: scale 1.15, deployments of 12 hops": Fault(YAW, lambda _: scaled(1.15), length=SHORT),
    "yaw: scale 0.85, deployments of 12 hops": Fault(YAW, lambda _: scaled(0.85), length=SHORT),
    "yaw: scale 0.85, measured ramps": Fault(YAW, lambda _: scaled(0.85), RAMPS),
    "yaw: scale 1.25, measured ramps": Fault(YAW, lambda _: scaled(1.25), RAMPS),
    "yaw: stands still, measured ramps": Fault(YAW, lambda _: scaled(0.0), RAMPS),
    "pitch: scale 0.93": Fault(PITCH, lambda _: scaled(0.93)),
    "pitch: scale 1.07": Fault(PITCH, lambda _: scaled(1.07)),
    "pitch: scale 1.07, measured ramps": Fault(PITCH, lambda _: scaled(1.07), RAMPS),
    "pitch: offset 0.2°": Fault(PITCH, lambda _: shifted(0.2, TURN[PITCH])),
    "pitch: offset 0.2° between deployments of 12 hops": Fault(
        PITCH, lambda _: shifted(0.2, TURN[PITCH]), length=SHORT, between=True
    ),
    "pitch: scale 1.07 between deployments of 12 hops": Fault(
        PITCH, lambda _: scaled(1.07), length=SHORT, between=True
    ),
}


class Run(NamedTuple):
    """What became of a run.

    Attributes:
        errors: Measured − true state of the hops with the fault, speed [m/s] and height [m]; shape (h, 2).
        learned: Which of them would be learned from; shape (h,).
        doubted: Whether a doubt ended the run.
    """

    errors: np.ndarray
    learned: np.ndarray
    doubted: bool


def run_of(name: str, seed: int) -> Run:
    """A run of a random twin with a fault."""
    sensor, make, ground, length, between = FAULTS[name]
    rng = np.random.default_rng(seed)
    gap = RealityGap.random(rng)
    profile = GroundProfile(gap, ROBOT.boom_length, rng, ground) if ground.is_measured else None
    twin, wrong, begin = Twin(ROBOT, gap, rng, ground=profile), make(rng), rng.uniform(1500, 3000)
    begin = inf if between else int(begin)
    limits = replace(example_limits(), **dict.fromkeys(OTHER_LIMITS, inf), shortest_leg=0.0, lowest_hip=-inf)
    limits = replace(limits, ground_height=limits.ground_height + ground.slope)
    ticks, iteration, errors, doubted, evidence = 0, 0, [], False, ()

    def change(_: int, reading: HopperReading) -> HopperReading:
        nonlocal ticks
        ticks += 1
        if ticks <= begin:
            return reading
        return reading._replace(**{sensor: float(round(wrong(int(ticks - begin - 1), getattr(reading, sensor))))})

    space = Hopper().space
    log, nothing = Steps(space), np.zeros(2)
    while len(log) < HOPS and iteration < 2 * HOPS // length and not doubted:
        made = 0
        begin = ticks if between and iteration == 1 else begin
        for control, flags, _, _ in deployment(twin, limits, rng, Trouble(0.05, 0.005), change, ground, evidence):
            ended = flags & (TickFlag.STOPPED | TickFlag.FAILED) != 0
            if flags & TickFlag.STEP_ENDED or ended:
                apex, made = control.state.apex, made + 1
                measured = np.full(2, np.nan) if ended else np.array([apex.speed, apex.height])
                record = StepRecord(nothing, nothing, nothing, measured, control.status)
                log += [LoggedStep(iteration, made, nothing, nothing, nothing, record)]
                errors.append(measured - twin.truth[:2] if ticks > begin and not ended else nothing)
            doubted = ended and Limited(control.state.watch.stopped) & DOUBTS != 0
            if ended or made == length or len(log) == HOPS:
                evidence = control.evidence
                break
        iteration += 1
    usable = (log.status == StepStatus.OK) & ~log.doubtful
    return Run(np.array(errors), usable, doubted)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="9000-9003")
    parser.add_argument("--faults", nargs="*", default=[""], help="parts of the names of faults")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    first, last = map(int, options.seeds.split("-"))
    names = [name for name in FAULTS if any(part in name for part in options.faults)]
    seeds = range(first, last + 1)
    pairs = list(product(names, seeds))
    with ProcessPoolExecutor(options.processes) as pool:
        runs = pool.map(run_of, *zip(*pairs, strict=True))
        for name in names:
            of_fault = [next(runs) for _ in seeds]
            learned = np.abs(np.vstack([run.errors[run.learned] for run in of_fault] + [np.zeros((1, 2))]))
            wrong = int((learned > (WRONG_SPEED, WRONG_HEIGHT)).any(axis=1).sum())
            worst = 1e3 * learned.max(axis=0)
            print(
                f"{name:44s} learned {len(learned) - 1:3d}, wrong {wrong:3d} ({worst[0]:.0f} mm/s, {worst[1]:.1f} mm)  "
                f"stopped {sum(run.doubted for run in of_fault)} of {len(seeds)}",
                flush=True,
            )


if __name__ == "__main__":
    main()
