"""Speed of `ApexMap` and of what is built on it, and the accuracy of its Jacobian, on random points.

    python -m benchmarks.map_speed [--count 1000] [--seed 0] [--stiffness K2] [--torque-limit T]

Run from the repository's root. Times are the best of many for batches on one core, medians and percentiles for single
calls. The Jacobian is compared with Richardson-extrapolated central differences of a map with tolerances of 1e-12;
root solves are from a cold start, to targets that the map reaches.
"""

import argparse
from collections.abc import Callable
from time import perf_counter

import numpy as np

from stepgap.control.step_controller import StepController
from stepgap.hybrid.integrator import Tolerance
from stepgap.robots.hopper import Gains, RobotParameters
from stepgap.robots.hopper.model.apex_map import SMALLEST_SHARE, ApexMap
from stepgap.robots.hopper.model.hop import Tolerances
from stepgap.step import difference_jacobian

EXACT = Tolerances(flight=Tolerance(1e-12, 1e-12), stance=Tolerance(1e-12, 1e-12))
ONE_CORE = 2 * SMALLEST_SHARE - 1  # points that are not divided among cores


def draw(apex_map: ApexMap, count: int, seed: int) -> np.ndarray:
    """Random points (speed, height, fx, fy) within the ranges."""
    quantities = (*apex_map.space.state, *apex_map.space.command)
    use = [[quantity.lower for quantity in quantities], [quantity.upper for quantity in quantities]]
    return np.random.default_rng(seed).uniform(*use, (count, 4))


def best(task: Callable[[], object], repeats: int = 200) -> float:
    """Shortest duration [s]."""
    durations = []
    for _ in range(repeats):
        begin = perf_counter()
        task()
        durations.append(perf_counter() - begin)
    return min(durations)


def report_speed(apex_map: ApexMap, points: np.ndarray) -> None:
    """Prints the time of a map, of its second half and of its Jacobian in a batch on one core."""
    state, command = points[:ONE_CORE, :2], points[:ONE_CORE, 2:]
    one_map = best(lambda: apex_map.evaluate(state, command)) / ONE_CORE
    second_half = best(lambda: apex_map.evaluate(state[0], command)) / ONE_CORE
    jacobian = best(lambda: apex_map.jacobian(state, command)) / ONE_CORE
    single = best(lambda: apex_map.evaluate(state[0], command[0]))
    print(f"map {1e6 * one_map:.1f} µs; many commands from one state {1e6 * second_half:.1f} µs each")
    print(f"Jacobian {1e6 * jacobian:.1f} µs, {jacobian / one_map:.2f} maps; a single call {1e6 * single:.1f} µs")


def report_jacobian(apex_map: ApexMap, points: np.ndarray) -> None:
    """Prints the largest error of the Jacobian relative to its largest entry."""
    exact_map = ApexMap(apex_map.robot, apex_map.gains, tolerances=EXACT)
    arguments = points[:, :2], points[:, 2:]
    wide, narrow = (difference_jacobian(exact_map, *arguments, step) for step in (5e-5, 2.5e-5))
    exact = (4 * narrow - wide) / 3
    error = np.abs(apex_map.jacobian(*arguments) - exact).max(axis=(1, 2)) / np.abs(exact).max(axis=(1, 2))
    print(f"Jacobian at {len(points)} points: largest error {error.max():.2g}, median {np.median(error):.2g}")
    for i in np.flatnonzero(~(error < 1e-5)):
        print(f"  {points[i].tolist()}: {error[i]:.2g}")


def report_root_solves(apex_map: ApexMap, points: np.ndarray) -> None:
    """Prints the time in which the step controller finds the command for a target, and how many it finds."""
    controller, targets = StepController(apex_map), apex_map(points[:, :2], points[:, 2:])
    durations, reached = [], 0
    for point, target in zip(points, targets, strict=True):
        begin = perf_counter()
        reached += controller(point[:2], target).reached
        durations.append(1e3 * (perf_counter() - begin))
    middle, late = np.quantile(durations, [0.5, 0.99])
    print(f"root solve: median {middle:.2f} ms, p99 {late:.2f} ms, {reached} of {len(points)} solved")


def main() -> None:
    """Prints the report."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stiffness", type=float, default=Gains().stiffness, help="virtual leg spring [N/m]")
    parser.add_argument("--torque-limit", type=float, default=RobotParameters().torque_limit, help="[N·m]")
    options = parser.parse_args()
    apex_map = ApexMap(RobotParameters(torque_limit=options.torque_limit), Gains(stiffness=options.stiffness))
    points = draw(apex_map, options.count, options.seed)
    report_speed(apex_map, points)
    report_jacobian(apex_map, points)
    report_root_solves(apex_map, points)


if __name__ == "__main__":
    main()
