"""Lane changes of a hopper in three dimensions, with one and with several steps planned together.

The robot is that of `spring_hopper_3d.py`: six states and four commands. Its reference has columns for what is tracked,
by default speed, height and offset; every 20 steps the offset changes by 0.3 m. Of each deployment it prints the root
mean square of the errors on the steps that are at least five after a change, in noise floors, and how many steps a
change takes: from the first step whose target is the new one to that from which on the offset stays within three noise
floors of it. The states without a target are those of straight hopping, so their errors are their distances from zero.

    ./go python -m benchmarks.lane_change [--seeds 31,32,33] [--horizons 1,2,3] [--tracked speed,height,offset]
"""

import argparse
import tempfile
from itertools import product
from pathlib import Path

import numpy as np

from benchmarks.spring_hopper_3d import SpringHopper3D
from stepgap.base.signals import terminated_as_interrupted
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.loop import Setup, run_experiment
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.step import Array

STEPS, PERIOD, SETTLED = 160, 20, slice(5, 17)
"""Steps of the reference, steps between changes of the offset, and which of these count as settled: a longer horizon
begins with the next change before it is due."""

LANE = 0.3
"""Distance between the lanes [m]."""


def lanes(tracked: tuple[str, ...]) -> Reference:
    """Two stairs of speed and height, and changes of the offset; the other tracked states are zero."""
    targets = np.zeros((STEPS, len(tracked)))
    number = np.arange(STEPS)
    known = {
        "speed": np.where(number < STEPS // 2, 0.3, 0.5),
        "height": np.where(number // 40 % 2 == 0, 0.67, 0.69),
        "offset": LANE * (number // PERIOD % 2),
    }
    for column, name in enumerate(tracked):
        targets[:, column] = known.get(name, np.zeros(STEPS))
    return Reference(tracked, targets)


def measure(robot: SpringHopper3D, horizon: int, seed: int) -> None:
    """Runs one redeployment and prints both deployments."""
    reference = lanes(robot.tracked).of(robot.space)
    settings, learning = Experiment(robot, seed=seed), LearningSettings(iterations=1, early_stop=False)
    nominal = load_nominal(settings).map
    with tempfile.TemporaryDirectory() as name, terminated_as_interrupted():
        folder = Path(name)
        plants = choose_plants(PlantRequest(settings, reference, folder))
        run_experiment(Setup(nominal, plants, reference, learning, ControlSettings(horizon=horizon), seed), folder)
        run = Run(folder, space=nominal.space)
        for deployment in run.deployments:
            steps = run.steps.of_iteration(deployment.iteration).completed()
            print_errors(steps, run.noise_floor, f"seed {seed}, horizon {horizon}, deployment {deployment.iteration}")


def print_errors(steps: Steps, floor: Array, title: str) -> None:
    """Prints errors on settled steps in noise floors, and how long the changes of the offset took."""
    offset = steps.space.state_names.index("offset")
    error = steps.next_state - np.where(np.isfinite(steps.target), steps.target, 0.0)
    settled = np.isin((steps.number - 1) % PERIOD, np.arange(PERIOD)[SETTLED])
    rmse = np.sqrt(np.mean(error[settled] ** 2, axis=0)) / floor
    taken = []
    for change in range(PERIOD, STEPS, PERIOD):
        outside = np.abs(error[change : change + SETTLED.stop, offset]) > 3 * floor[offset]
        taken.append(int(np.flatnonzero(outside)[-1] + 1) if outside.any() else 0)
    parts = ", ".join(f"{name} {value:.1f}" for name, value in zip(steps.space.state_names, rmse, strict=True))
    print(f"{title}: {len(steps)} steps; {parts}; steps of the lane changes {taken}", flush=True)


def main() -> None:
    """Prints two lines for each seed and horizon."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("--seeds", "31,32,33"), ("--horizons", "1,2,3")):
        parser.add_argument(name, default=default, type=lambda text: [int(part) for part in text.split(",")])
    parser.add_argument("--tracked", default="speed,height,offset", type=lambda text: tuple(text.split(",")))
    given = parser.parse_args()
    for horizon, seed in product(given.horizons, given.seeds):
        measure(SpringHopper3D(tracked=given.tracked), horizon, seed)


if __name__ == "__main__":
    main()
