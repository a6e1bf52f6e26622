"""Accuracy of `ApexMap` against the independent hop of the tests, on random states and commands.

    python -m benchmarks.map_accuracy [--count 1000] [--seed 0] [--stiffness K2] [--torque-limit T] [--wide]

Run from the repository's root. The error is relative to the larger of |reference| and half the range.
`--wide` draws from a much larger range, where most hops fail, and compares the status codes.
"""

import argparse
import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from time import perf_counter

import numpy as np

from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.step import StepStatus
from tests.robots.hopper.model.reference_hop import Hopper, reference_hop

WIDE = np.array([[-3.0, 0.1, -300.0, -300.0], [3.0, 1.5, 300.0, 300.0]])


@cache
def hopper(robot: RobotParameters, gains: Gains) -> Hopper:
    """The reference, derived once per process."""
    return Hopper(robot, gains)


def reference(robot: RobotParameters, gains: Gains, point: np.ndarray) -> tuple[StepStatus, np.ndarray]:
    """Status and next state of one point (speed, height, fx, fy)."""
    return reference_hop(hopper(robot, gains), point[:2], point[2:])


def draw(apex_map: ApexMap, wide: bool, count: int, seed: int) -> np.ndarray:
    """Random points (speed, height, fx, fy)."""
    quantities = (*apex_map.space.state, *apex_map.space.command)
    ranges = [[quantity.lower for quantity in quantities], [quantity.upper for quantity in quantities]]
    return np.random.default_rng(seed).uniform(*(WIDE if wide else ranges), (count, 4))


def median_time(apex_map: ApexMap, points: np.ndarray) -> float:
    """Median duration of one evaluation [s]."""
    durations = []
    for point in points:
        begin = perf_counter()
        apex_map.evaluate(point[:2], point[2:])
        durations.append(perf_counter() - begin)
    return float(np.median(durations))


def main() -> None:
    """Prints the largest errors and the points where the status codes differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stiffness", type=float, default=Gains().stiffness, help="virtual leg spring [N/m]")
    parser.add_argument("--torque-limit", type=float, default=RobotParameters().torque_limit, help="[N·m]")
    parser.add_argument("--wide", action="store_true", help="speeds ±3 m/s, heights 0.1–1.5 m, forces ±300 N")
    options = parser.parse_args()

    apex_map = ApexMap(RobotParameters(torque_limit=options.torque_limit), Gains(stiffness=options.stiffness))
    points = draw(apex_map, options.wide, options.count, options.seed)
    outcome = apex_map.evaluate(points[:, :2], points[:, 2:])
    with ProcessPoolExecutor(os.cpu_count()) as pool:
        same = [apex_map.robot] * len(points), [apex_map.gains] * len(points)
        references = list(pool.map(reference, *same, points, chunksize=5))

    expected = np.array([next_state for _, next_state in references])
    statuses = np.array([status for status, _ in references])
    scale = np.maximum(np.abs(expected), apex_map.space.state_scale)
    error = np.abs(outcome.next_state - expected) / scale
    both = (statuses == StepStatus.OK) & (outcome.status == StepStatus.OK)
    counts = {StepStatus(code).label: count for code, count in Counter(statuses.tolist()).items()}
    print(f"status codes of {len(points)} points: {counts}")
    if both.any():
        for name, column in zip(apex_map.space.state_names, error[both].T, strict=True):
            print(f"{name}: largest relative error {column.max():.2g}, median {np.median(column):.2g}")
    different = np.flatnonzero(statuses != outcome.status)
    print(f"status codes that differ: {len(different)}")
    for i in different[:40]:
        found, correct = StepStatus(int(outcome.status[i])).label, StepStatus(int(statuses[i])).label
        print(f"  {points[i].tolist()}: map {found} {outcome.next_state[i]}, reference {correct} {expected[i]}")
    print(f"median time of one evaluation: {1e6 * median_time(apex_map, points[:500]):.0f} µs")


if __name__ == "__main__":
    main()
