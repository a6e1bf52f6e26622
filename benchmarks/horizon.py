"""Changes of the target that one step cannot make, with one and with several steps planned together.

For each random twin (−1: the preset `paper`), seed and horizon, two redeployments, and of the last one the root mean
square of the errors in half ranges: of a square wave between (0.05 m/s, 0.53 m) and (0.38 m/s, 0.63 m) that changes
every six steps, or of the transients of the paper's reference, with the bound `command.fx_lower` = −12.5 N, which
explains the braking of the paper's hardware (docs/evidence.md), or without it. Below, the ratios to the first horizon,
paired by twin, with their 95 % intervals by Student's t on the logarithm.

    ./go python -m benchmarks.horizon [square|braking|paper] [--twins 11,12,13] [--seeds 21,22] [--horizons 1,2,3]
"""

import argparse
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from itertools import product
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import own_priors
from benchmarks.ratios import ratio
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context, usable_cores
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.loop import Setup, run_experiment
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper

FIRST, PERIOD, STEPS = 12, 6, 108
"""Steps of the square wave before its first change, between changes, and in all."""

LOW, HIGH = (0.05, 0.53), (0.38, 0.63)
"""Speed [m/s] and height [m] of the square wave."""

BRAKING = -12.5
"""Lower bound of fx [N] with which the published method brakes like the hardware."""


class Case(NamedTuple):
    """One run."""

    kind: str
    twin: int
    seed: int
    horizon: int


class Found(NamedTuple):
    """Errors of its last deployment: root mean square [half ranges], largest of height [mm]; falls; CPU time [s]."""

    error: float
    miss: float
    falls: int
    seconds: float


def square_wave() -> Reference:
    """The square wave."""
    changes = [(1, LOW), *((1 + start, (HIGH, LOW)[k % 2]) for k, start in enumerate(range(FIRST, STEPS, PERIOD)))]
    return Reference.from_segments(("speed", "height"), changes, STEPS)


def measure(case: Case) -> Found:
    """Runs a case."""
    robot = Hopper() if case.twin < 0 else Hopper().randomised(random_stream(0, case.twin))
    if case.kind == "braking":
        robot = replace(robot, command=replace(robot.command, fx_lower=BRAKING))
    reference = square_wave() if case.kind == "square" else paper_reference()
    settings, learning = Experiment(robot, seed=case.seed), LearningSettings(iterations=2, early_stop=False)
    nominal, begin = load_nominal(settings).map, process_time()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plants = choose_plants(PlantRequest(settings, reference, folder))._replace(measure_noise_floor=None)
        control = ControlSettings(horizon=case.horizon)
        setup = Setup(nominal, plants, reference, learning, control, case.seed, priors=own_priors(robot))
        last = run_experiment(setup, folder)[-1]
        steps = Run(folder, space=nominal.space).steps.of_iteration(last.iteration).completed()
    counted = np.arange(FIRST, STEPS) if case.kind == "square" else reference.transient
    error = ((steps.next_state - steps.target) / nominal.space.error_scale)[np.isin(steps.number - 1, counted)]
    miss = 1e3 * nominal.space.state_scale[1] * np.abs(error[:, 1]).max()
    return Found(float(np.sqrt(np.mean(np.sum(error**2, axis=1)))), miss, last.failed_steps, process_time() - begin)


def print_ratios(
    found: dict[Case, Found], kind: str, twins: Sequence[int], seeds: Sequence[int], horizon: int, to: int
) -> None:
    """Prints the ratio of errors with one horizon to those with another."""
    errors = np.array(
        [[[found[Case(kind, twin, seed, steps)].error for steps in (horizon, to)] for seed in seeds] for twin in twins]
    )
    logs = np.log(errors[..., 0] / errors[..., 1]).mean(axis=1)
    print(f"horizon {horizon} / {to}: {ratio(logs)}")


def main() -> None:
    """Prints a line for each twin and seed, and the ratios."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kind", nargs="?", choices=("square", "braking", "paper"), default="square")
    for name, default in (("--twins", "11,12,13,14,15"), ("--seeds", "21,22,23"), ("--horizons", "1,2,3")):
        parser.add_argument(name, default=default, type=lambda text: [int(part) for part in text.split(",")])
    given = parser.parse_args()
    cases = [Case(given.kind, *numbers) for numbers in product(given.twins, given.seeds, given.horizons)]
    with ProcessPoolExecutor(usable_cores(), mp_context=process_context()) as pool:
        found = dict(zip(cases, pool.map(measure, cases), strict=True))
    for twin, seed in product(given.twins, given.seeds):
        each = [found[Case(given.kind, twin, seed, horizon)] for horizon in given.horizons]
        cells = [f"{one.error:.4f}, miss {one.miss:3.0f} mm, {one.falls} falls, {one.seconds:4.1f} s" for one in each]
        print(f"twin {twin}, seed {seed}: {' | '.join(cells)}")
    for horizon in given.horizons[1:]:
        print_ratios(found, given.kind, given.twins, given.seeds, horizon, given.horizons[0])


if __name__ == "__main__":
    main()
