"""How many next states of the hopper lie in their 95 % intervals, at rest and at each speed?

A deployment has 5 targets of the speed, 200 hops each, in an order that the seed draws, at heights that change every 20
hops. Deployment 0 has no correction; deployment 1 learned from it. A hop counts for the speed that is its target; the
interval is the predicted next state ± 1.96 of its standard deviation, as they are recorded with the step. Printed are
the shares of speeds and of heights for each speed and deployment, and of all twins together: the preset `paper`
(number −1) and random twins.

    ./go python -m benchmarks.coverage [--twins -1,700,701,702] [--seeds 41] [--methods default,online]
"""

import argparse
from itertools import product
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import METHODS, finished, tracked, uncorrected
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.bands import interval_coverage
from stepgap.learning.learner import Learner
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import TwinSimulation
from stepgap.step import Array

SPEEDS, HOPS = (0.0, 0.1, 0.2, 0.3, 0.4), 200
"""Targets of the speed [m/s], and hops of each."""

HEIGHTS, HEIGHT_HOPS = (0.55, 0.57, 0.59, 0.61, 0.625), 20
"""Targets of the height [m], and hops of each."""


class Case(NamedTuple):
    """One deployment."""

    method: str
    twin: int
    seed: int


class Covered(NamedTuple):
    """Hops within their intervals, by speed.

    Attributes:
        inside: Number of speeds and heights within; shape (speeds, 2).
        counted: Number of those with an interval; shape (speeds, 2).
        fell: Whether the robot fell.
    """

    inside: Array
    counted: Array
    fell: bool


def floors(rng: np.random.Generator) -> Reference:
    """All speeds in a random order, each with all heights in a random order."""
    speeds = np.repeat(rng.permutation(SPEEDS), HOPS)
    heights = np.concatenate([rng.permutation(HEIGHTS) for _ in range(len(speeds) // (len(HEIGHTS) * HEIGHT_HOPS))])
    return Reference(("speed", "height"), np.stack([speeds, np.repeat(heights, HEIGHT_HOPS)], axis=1))


def measure(case: Case) -> Covered:
    """Runs a case."""
    robot = Hopper() if case.twin < 0 else Hopper().randomised(random_stream(case.twin))
    simulation = TwinSimulation(robot.parameters, robot.gap, robot.control, random_stream(case.seed))
    nominal, reference = robot.apex_map(), floors(random_stream(case.seed, 2))
    with one_blas_thread():
        known = tracked(uncorrected(nominal), simulation.plant(random_stream(case.seed, 0)), reference, 0)
        learner = Learner.start(nominal, known, METHODS[case.method], 1)
        steps = tracked(learner, simulation.plant(random_stream(case.seed, 1)), reference, 1)
    speed = steps.target[:, 0]
    found = [interval_coverage(steps.selected(np.isclose(speed, wanted))) for wanted in SPEEDS]
    inside, counted = (np.array(part) for part in zip(*found, strict=True))
    return Covered(inside, counted, bool(steps.failed_steps))


def print_shares(label: str, inside: Array, counted: Array, falls: int) -> None:
    """Prints the shares of speeds and heights within their intervals [%]."""
    shares = 100 * inside / np.where(counted, counted, np.nan)
    cells = "  ".join(f"{speed:5.1f} /{height:5.1f}" for speed, height in shares)
    whole = 100 * inside.sum(axis=0) / counted.sum(axis=0)
    print(f"{label:26}{cells}  {whole[0]:5.1f} /{whole[1]:5.1f}  {int(falls)} falls")


def main() -> None:
    """Prints a row for each method and deployment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", default="-1,700,701,702", type=lambda text: [int(part) for part in text.split(",")])
    parser.add_argument("--seeds", default="41", type=lambda text: [int(part) for part in text.split(",")])
    parser.add_argument("--methods", default=",".join(METHODS))
    given = parser.parse_args()
    methods = given.methods.split(",")
    cases = [Case(*case) for case in product(methods, given.twins, given.seeds)]
    unordered = dict(finished(measure, cases))
    found = {case: unordered[case] for case in cases}
    print("95 % intervals: share of speeds / heights within [%], by target of the speed [m/s]")
    print(f"{'':26}{'  '.join(f'{speed:>12}' for speed in SPEEDS)}  {'all':>12}")
    for method in methods:
        some = {case: covered for case, covered in found.items() if case.method == method}
        for case, covered in some.items():
            print_shares(f"{method}, twin {case.twin}, seed {case.seed}", *covered)
        sums = (np.sum([getattr(each, name) for each in some.values()], axis=0) for name in ("inside", "counted"))
        print_shares(f"{method}, all", *sums, sum(each.fell for each in some.values()))


if __name__ == "__main__":
    main()
