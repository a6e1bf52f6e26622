"""How cost grows: with the hops of a deployment, with states and commands, with known steps, with the cases of a sweep.

    ./go python -m benchmarks.growth [--parts hops,sizes,fits,cases] [--hops 20000] [--known 50000]

Processor time of one process, its linear algebra in one thread. The script uses only what versions have in common, so
that it can be run with the sources of an earlier one.

- hops: online, with the hopper's map as the robot and another hopper's as the nominal map; no simulator.
- sizes: 150 steps online of an affine robot, after 200 random ones, by the number of states and commands.
- fits: the Gaussian process of one output of four inputs, and what the default learner begins with, by known steps.
- cases: the plan of a sweep, by its number of cases.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import process_time

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.gauss.gaussian_process_fit import fit_gaussian_process
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.step import Array, Quantity, StepMap, StepSpace

SIZES, KNOWN, CASES = (2, 4, 8, 12), (200, 1000, 5000, 50000), (100, 1000, 10000)
LEARNED, STEPS = 200, 150
STEPGAP = "from stepgap.cli.app import main; main()"
NOISE = 0.01
"""Standard deviation of the noise of a step [half ranges]."""


def hopping(count: int) -> Iterator[object]:
    """The hops of a deployment that learns from the first one on."""
    nominal = ApexMap(RobotParameters(), Gains(), CommandBounds())
    robot = ApexMap(RobotParameters(body_mass=1.03 * RobotParameters().body_mass), Gains(), CommandBounds())
    noise = NOISE * nominal.space.state_scale
    targets = np.resize([[0.3, 0.6], [0.2, 0.58], [0.38, 0.56]], (count // 6 + 1, 2))
    reference = Reference(("speed", "height"), np.repeat(targets, 6, axis=0)[:count])
    learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(online=True), 0)
    return deploy(learner, ModelPlant(robot, noise=noise, rng=np.random.default_rng(0)), reference, 0)


def hops(count: int) -> None:
    """Time of a hop at the beginning and at the end of a long deployment."""
    list(hopping(5))  # compiles
    marks = [0, *(mark for mark in (100, 1000, 10000, 100000) if mark < count), count]
    steps = hopping(count)
    for begin, end in pairwise(marks):
        start = process_time()
        for _ in range(end - begin):
            next(steps)
        print(f"hops {begin + 1} to {end}: {1e3 * (process_time() - start) / (end - begin):.2f} ms each", flush=True)


def affine_robot(size: int) -> tuple[StepMap, StepMap, Steps]:
    """A robot with as many states as commands, its nominal map, and random steps of it."""
    rng = np.random.default_rng(size)
    state = tuple(Quantity(f"s{i}", "m", -1.0, 1.0) for i in range(size))
    space = StepSpace(state, tuple(Quantity(f"c{i}", "N", -1.0, 1.0) for i in range(size)))
    matrix = np.hstack([0.5 * np.eye(size), 0.8 * np.eye(size)])
    zero = np.zeros(size)
    nominal = AffineMap(space, zero, zero, zero, matrix)
    robot = AffineMap(space, 0.1 + zero, zero, zero, matrix + 0.05 * rng.normal(size=matrix.shape) / np.sqrt(size))
    states, commands = np.split(rng.uniform(-1, 1, (LEARNED, 2 * size)), 2, axis=1)
    after = robot(states, commands) + NOISE * rng.normal(size=states.shape)
    columns = {"state": states, "command": commands, "next_state": after, "predicted": nominal(states, commands)}
    return robot, nominal, Steps.of_columns(space, **columns)


def sizes() -> None:
    """Time of a step by the number of states and commands."""
    for size in SIZES:
        robot, nominal, known = affine_robot(size)
        rng = np.random.default_rng(0)
        targets = np.repeat(rng.uniform(-0.4, 0.4, (STEPS // 5, size)), 5, axis=0)
        names = tuple(quantity.name for quantity in nominal.space.state)
        begin = process_time()
        learner = Learner.start(nominal, known, LearningSettings(), 1)
        started = process_time()
        list(deploy(learner, ModelPlant(robot, noise=NOISE, rng=rng), Reference(names, targets), 1))
        took = 1e3 * (process_time() - started) / STEPS
        print(f"{size} states, {size} commands: {took:.1f} ms a step, begun in {started - begin:.2f} s", flush=True)


def smooth(points: Array) -> Array:
    """A function of points (N, 4)."""
    x, y, u, v = points.T
    return 0.04 + 0.03 * np.sin(1.3 * x + 0.5 * u) + 0.02 * np.tanh(y * v) + 0.01 * u**2


def fits(most: int) -> None:
    """Time of a fit, and of what the learner begins with, by the number of known steps, up to a largest one."""
    _, nominal, _ = affine_robot(2)
    for count in (count for count in KNOWN if count <= most):
        rng = np.random.default_rng(count)
        points = rng.uniform(-1, 1, (count, 4))
        values = smooth(points) + NOISE * rng.normal(size=count)
        begin = process_time()
        fit_gaussian_process(points, values, np.ones(4), 0.2)
        fitted = process_time()
        states, commands = points[:, :2], points[:, 2:]
        predicted = nominal(states, commands)
        columns = {"state": states, "command": commands, "next_state": predicted + values[:, None]}
        known = Steps.of_columns(nominal.space, **columns, predicted=predicted)
        begun = process_time()
        Learner.start(nominal, known, LearningSettings(), 1)
        print(f"{count} steps: {fitted - begin:.2f} s a fit, {process_time() - begun:.2f} s the learner", flush=True)


def cases() -> None:
    """Time of the plan of a sweep."""
    for count in CASES:
        with TemporaryDirectory() as folder:
            sweep = Path(folder) / "sweep.toml"
            sweep.write_text(f"seeds = {list(range(count))}\n")
            before = getrusage(RUSAGE_CHILDREN)
            command = [sys.executable, "-c", STEPGAP, "sweep", str(sweep), "--plan"]
            subprocess.run(command, check=True, capture_output=True)
            after = getrusage(RUSAGE_CHILDREN)
        took = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        print(f"{count} cases: planned in {took:.1f} s", flush=True)


def main() -> None:
    """Prints the parts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="hops,sizes,fits,cases")
    parser.add_argument("--hops", type=int, default=20000)
    parser.add_argument("--known", type=int, default=50000)
    given = parser.parse_args()
    measured = {"hops": lambda: hops(given.hops), "sizes": sizes, "fits": lambda: fits(given.known), "cases": cases}
    with threadpool_limits(limits=1, user_api="blas"):
        for part in given.parts.split(","):
            measured[part]()


if __name__ == "__main__":
    main()
