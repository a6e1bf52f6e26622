"""Which step command on which floor: landing angle and fy against the paper's fx and fy, and others.

For each pair, friction of the floor and seed, the twin takes the reference of the paper twice: by the nominal map, and
after it has learned from these steps. Errors are those of the measured state, over the steps before a fall. The slip is
that of the foot along the floor in a stance, by the boom's yaw and the leg while the foot carries the robot's weight:
the median of all stances, and the share of stances that slip by more than 10 mm.

    ./go python -m benchmarks.knobs [--pairs fx+fy,speed_setpoint+fy] [--frictions 0.25,0.3,0.363,0.45,0.6]
        [--seeds 1,2,3] [--steps 227] [--workers 1]
"""

import argparse
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import replace
from itertools import product
from math import tau
from typing import Any, NamedTuple, cast

import numpy as np

from benchmarks.disturbed_plant import own_priors
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.model.dynamics import masses_of
from stepgap.robots.hopper.model.leg import foot, four_bar, leg_of
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.sensors import hopper_sensors
from stepgap.robots.hopper.tick.tick_row import TICK_COLUMN
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model
from stepgap.step import Array, StepStatus

SLIPS = 0.01
"""Slip that counts as one [m]."""


class Case(NamedTuple):
    """One robot on one floor."""

    pair: tuple[str, ...]
    friction: float
    seed: int
    steps: int


class Deployed(NamedTuple):
    """What one deployment gave: RMSE [m/s, m], median slip [m], share of stances that slip, steps, and falls."""

    rmse: Array
    slip: float
    slips: float
    steps: int
    falls: int


def measured(case: Case) -> tuple[Case, list[Deployed]]:
    """A deployment by the nominal map, and one after learning."""
    robot = Hopper(command=CommandBounds(pair=case.pair), gap=replace(RealityGap(), ground_friction=case.friction))
    nominal, settings, priors = robot.apex_map(), LearningSettings(), own_priors(robot)
    targets = paper_reference().targets[: case.steps]
    reference = Reference(nominal.space.state_names, targets)
    simulation = robot.simulations()["twin"](random_stream(case.seed, 0))
    steps, found = Steps(nominal.space), []
    with one_blas_thread():
        for iteration in range(2):
            learner, rows = Learner.start(nominal, steps, settings, iteration, priors), list[Array]()
            plant = simulation.plant(
                random_stream(case.seed, 1, iteration), lambda ticks, _, rows=rows: rows.append(np.array(ticks))
            )
            with closing(deploy(learner, plant, reference, iteration)) as taken:
                logged = list(taken)
            steps += logged
            done = [each for each in logged if each.record.status == StepStatus.OK]
            errors = np.array([each.record.next_state - each.target for each in done]).reshape(-1, 2)
            slips = np.array(list(stance_slips(robot, np.concatenate(rows))))
            falls = len(logged) - len(done)
            rmse = np.sqrt(np.nanmean(errors**2, axis=0))
            found.append(Deployed(rmse, float(np.median(slips)), float((slips > SLIPS).mean()), len(done), falls))
    return case, found


def stance_slips(robot: Hopper, rows: Array) -> Iterator[float]:
    """How far the foot moved along the floor in each stance [m]."""
    sensors, leg = hopper_sensors(twin_sensor_model(robot.parameters, robot.gap)), leg_of(robot.parameters)
    alpha_1, alpha_2 = rows[:, TICK_COLUMN.alpha_1], rows[:, TICK_COLUMN.alpha_2]
    python = [cast(Any, each).py_func for each in (four_bar, foot)]  # for arrays
    toe = python[1](leg, python[0](leg, alpha_2), alpha_1)
    travel = sensors.boom_length * tau * rows[:, TICK_COLUMN.boom_horizontal] / sensors.boom_counts_horizontal + toe.x
    loaded = rows[:, TICK_COLUMN.contact_force] > masses_of(robot.parameters).weight
    for stance in np.split(travel, np.flatnonzero(np.diff(loaded.astype(int))) + 1)[int(not loaded[0]) :: 2]:
        if len(stance) > 10:  # shorter ones are bounces
            yield float(np.ptp(stance))


def main() -> None:
    """Prints a line per case and deployment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pairs", default="fx+fy,speed_setpoint+fy")
    parser.add_argument("--frictions", default="0.25,0.3,0.363,0.45,0.6")
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--steps", type=int, default=227)
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args()
    pairs = [tuple(pair.split("+")) for pair in options.pairs.split(",")]
    frictions, seeds = map(float, options.frictions.split(",")), map(int, options.seeds.split(","))
    cases = [Case(*each, options.steps) for each in product(pairs, frictions, seeds)]
    print("pair                     friction seed deployment  RMSE [mm/s / mm]  slip [mm]  slips  steps  falls")
    with ProcessPoolExecutor(options.workers, mp_context=process_context()) as pool:
        for case, found in pool.map(measured, cases):
            for number, each in enumerate(found):
                rmse = f"{1e3 * each.rmse[0]:.1f} / {1e3 * each.rmse[1]:.2f}"
                print(
                    f"{' + '.join(case.pair):25}{case.friction:8g} {case.seed:4d} {number:10d}  {rmse:>16}  "
                    f"{1e3 * each.slip:9.1f}  {each.slips:5.0%}  {each.steps:5d}  {each.falls:5d}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
