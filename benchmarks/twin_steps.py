"""What the twin's physics steps cost, and by how much they change its motion.

From random starts the twin makes its first flight and a hop, with physics steps of several lengths and with the same
noise. The error is the difference of its true apexes from those with sixteen steps in every tick, the time is that of
the whole loop with its controller. Single starts, in which an event falls into another tick, differ by much more than
the median.

    python -m benchmarks.twin_steps [--starts 40] [--gap paper|none|random]
"""

# pyright: reportAttributeAccessIssue=false
# (The lengths of the steps are constants of the twin, which only this benchmark and `false_alarms.py` change.)

import argparse
from time import thread_time

import numpy as np

from stepgap.base.errors import StepGapError
from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin import twin as twin_module
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array

TICK = 1e-3
REFERENCE = (16, 16)
STEPS = (REFERENCE, (8, 8), (4, 4), (8, 1), (6, 1), (4, 1), (3, 1), (2, 1))
"""Numbers of steps in a tick near the ground and in flight; the twin's are (4, 1)."""

ROBOT = RobotParameters()
GAPS = {"paper": lambda start: RealityGap(), "none": lambda start: RealityGap.none()}
GAPS["random"] = lambda start: RealityGap.random(np.random.default_rng(start))


def apexes(steps: tuple[int, int], gap: RealityGap, start: int) -> tuple[Array, float]:
    """Speed [m/s] and height [m] of the first two apexes after a start, NaN where the robot fell, and the time [s]."""
    near, above = steps
    twin_module.STANCE_STEP, twin_module.FLIGHT_STEP, twin_module.FEWEST_STEPS = TICK / near, TICK / above, 1
    rng = np.random.default_rng([start, 1])
    speed, height = rng.uniform([-0.1, 0.53], [0.4, 0.6])
    command = np.array([-7.0, -6.0]) + rng.uniform(-2, 2, 2)
    twin = Twin(ROBOT, gap, rng, TICK, start_height=height, start_speed=speed)
    control = HopperControl(ROBOT, Gains(), CommandBounds())
    begin = thread_time()
    try:
        with RigPlant(twin, control) as plant:
            plant.start()
            first = twin.truth
            plant.take_step(command)
            states = np.array([*first, *twin.truth])
    except StepGapError:
        states = np.full(4, np.nan)
    return states, thread_time() - begin


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--starts", type=int, default=40)
    parser.add_argument("--gap", choices=GAPS, default="paper")
    options = parser.parse_args()
    apexes(REFERENCE, RealityGap(), 0)  # compiles
    states = np.empty((len(STEPS), options.starts, 4))
    times = np.empty((len(STEPS), options.starts))
    for start in range(options.starts):
        gap = GAPS[options.gap](start)
        for row, steps in enumerate(STEPS):
            states[row, start], times[row, start] = apexes(steps, gap, start)
    errors = 1e3 * (states - states[0])
    print("median (RMS) of |error|: first apex [mm/s, mm], second apex [mm/s, mm]; time as a part of that of (4, 1)")
    for steps, error, time in zip(STEPS, errors, times.sum(axis=1) / times[STEPS.index((4, 1))].sum(), strict=True):
        median = np.nanmedian(np.abs(error), axis=0)
        rms = np.sqrt(np.nanmean(error**2, axis=0))
        print(steps, *(f"{m:.2f} ({r:.2f})" for m, r in zip(median, rms, strict=True)), f"{time:.2f}", sep="\t")


if __name__ == "__main__":
    main()
