"""Timing of the control loop of the real-time process, at 1 and 4 kHz, alone and beside six busy loops.

    ./go python benchmarks/control_loop.py [--seconds 30] [--busy 0 6]

The rig has constant sensor values, so that the computer alone is measured: kernel, Python and the hopper's control.
Prints the delay of the start of the ticks and the time that they took, and what the kernel refused.
"""

import argparse
import subprocess
import sys
from functools import partial

import numpy as np

from stepgap.hardware.commissioning.limp import limp_setup, ticks_of
from stepgap.hardware.hopper.still import still_hopper
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array

TICKS = (1e-3, 2.5e-4)
SHARES = (0.5, 0.999, 1.0)


def quantiles(seconds: Array) -> str:
    """Median, 99.9 % quantile and maximum [µs]."""
    return " ".join(f"{1e6 * value:8.1f}" for value in np.quantile(seconds, SHARES))


def measured(tick: float, seconds: float) -> str:
    """A line on the ticks of a rig without torque.

    Args:
        tick: Time between two of them [s].
        seconds: Duration of the measurement [s].
    """
    setup = limp_setup(partial(still_hopper, tick), Hopper().control())
    ticks = ticks_of(setup, round(seconds / tick))
    late, took = ticks.table["late"], ticks.table["took"]
    missed = int((late / tick).astype(int).sum())
    failed = f"; {ticks.fault}" if ticks.fault else ""
    return f"late {quantiles(late)}, took {quantiles(took)} µs, {missed} of {len(late)} missed; {ticks.refused}{failed}"


def main() -> None:
    """Prints a line for each interval and load: median, 99.9 % and maximum."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--busy", type=int, nargs="+", default=[0, 6], help="numbers of busy loops beside it")
    given = parser.parse_args()
    for busy in given.busy:
        loops = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(busy)]
        try:
            for tick in TICKS:
                print(f"{1e-3 / tick:g} kHz, {busy} busy loops: {measured(tick, given.seconds)}", flush=True)
        finally:
            for loop in loops:
                loop.kill()


if __name__ == "__main__":  # the real-time process imports this file
    main()
