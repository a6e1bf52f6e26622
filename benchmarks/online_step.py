"""Cost of learning from hop to hop: adding a step and planning the next one, while fits run in the background.

A model with a heavier body replaces the robot. Between two steps a small computation runs every millisecond for the
duration of a hop, as in a control loop, so that a fit in the background has as much time as on the robot.

    ./go python benchmarks/online_step.py --known 500

If other programs use the cores as well, the scheduler sometimes interrupts the computation for about 4 ms. A control
loop therefore has real-time priority. To measure with it: `chrt -f 10 ./go python …`.
"""

import argparse
from dataclasses import replace
from itertools import islice
from time import perf_counter, sleep

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.control.cautious_controller import CautiousController
from stepgap.experiment.deployment import deploy
from stepgap.learning.background import BackgroundThread
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.parameters import RobotParameters

NOISE = np.array([0.008, 0.0013])
"""Noise floor of the twin [m/s, m]."""
TICK, STATE, COMMAND = 1e-3, np.array([0.2, 0.58]), np.zeros(2)


def hops(nominal: ApexMap, count: int, seed: int) -> list[LoggedStep]:
    """Steps of the uncorrected controller on the heavier robot, from consecutive deployments."""
    robot = RobotParameters()
    heavier = ApexMap(replace(robot, body_mass=1.15 * robot.body_mass))
    steps: list[LoggedStep] = []
    while len(steps) < count:
        plant = ModelPlant(heavier, np.array([0.0, 0.55]), NOISE, np.random.default_rng([seed, len(steps)]))
        uncorrected = Learner.start(nominal, Steps(nominal.space), LearningSettings(), iteration=0)
        steps += islice(deploy(uncorrected, plant, paper_reference(), iteration=0), count - len(steps))
    return steps


def measure(nominal: ApexMap, known: list[LoggedStep], new: list[LoggedStep], hop: float) -> list[float]:
    """Times from a measured apex to the next command, for each of the new steps [s]."""
    seconds = []
    learner = Learner.start(nominal, Steps(nominal.space, known), LearningSettings(online=True), 0)
    with BackgroundThread() as background:
        for logged in new:
            begin = perf_counter()
            learner = learner.after(logged)
            controller = CautiousController(learner.step_map(), nominal, learner.failures)
            controller(logged.record.next_state, logged.target, guess=logged.record.command)
            seconds.append(perf_counter() - begin)
            background.compute(learner.pending)
            _tick_for(hop, nominal)
    return seconds


def _tick_for(duration: float, nominal: ApexMap) -> None:
    """Computation in place of the 1 kHz loop of a hop."""
    end = perf_counter() + duration
    while perf_counter() < end:
        nominal(STATE, COMMAND)
        sleep(TICK)


def main() -> None:
    """Prints quantiles of the times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--known", type=int, default=500, help="number of known steps")
    parser.add_argument("--steps", type=int, default=100, help="number of timed steps")
    parser.add_argument("--hop", type=float, default=0.75, help="duration of a hop [s]")
    options = parser.parse_args()
    nominal = ApexMap()
    with threadpool_limits(limits=1, user_api="blas"):
        steps = hops(nominal, options.known + options.steps, seed=0)
        seconds = measure(nominal, steps[: options.known], steps[options.known :], options.hop)
    median, high, most = 1e3 * np.quantile(seconds, [0.5, 0.99, 1.0])
    print(f"{options.known} steps known: median {median:.2f} ms, 99 % within {high:.2f} ms, all within {most:.2f} ms")


if __name__ == "__main__":
    main()
