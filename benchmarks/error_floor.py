"""Division of the tracking errors of a deployment into noise and the part that a map could still learn.

The last deployment of a run on the twin is simulated again. Each of its steps is also taken by several copies of the
twin in exactly the same motion at the same yaw, but with other torque noise. Their standard deviation is the noise; the
remaining error is that of the controller's map, including the effect of an oscillating boom, which no sensor measures.

    ./go python benchmarks/error_floor.py RUN…
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.base.random_streams import random_stream
from stepgap.experiment.deployment import deploy
from stepgap.experiment.loop import deployment_generator
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.run import Run
from stepgap.experiment.settings import read_experiment
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant, RepeatablePlant
from stepgap.records.steps_csv import digest, read_step_log
from stepgap.robots.hopper.paper import paper_reference
from stepgap.step import Array, StepRecord, StepSpace

REPEATS = 8
"""Number of copies that take each step."""


class Repeating(Plant):
    """A plant on a twin that takes every step in copies before it takes it itself.

    Args:
        plant: Plant of the twin.
        rng: Draws the copies' noise.

    Attributes:
        variances: Variances of the next states of the copies, step by step; shapes (n,).
    """

    def __init__(self, plant: RepeatablePlant, rng: np.random.Generator):
        self._plant, self._rng = plant, rng
        self.variances: list[Array] = []

    @property
    def space(self) -> StepSpace:
        """State and command of the plant."""
        return self._plant.space

    def start(self) -> Array:
        """Starts the plant."""
        return self._plant.start()

    def take_step(self, command: Array) -> StepRecord:
        """Takes the step in `REPEATS` copies, then in the plant itself."""
        ends = [self._plant.repeated(command, self._rng) for _ in range(REPEATS)]
        self.variances.append(np.var(ends, axis=0, ddof=1))
        return self._plant.take_step(command)

    def stop(self) -> None:
        """Stops the plant."""
        self._plant.stop()


def floor(folder: Path) -> tuple[int, Array, Array]:
    """Number of the last deployment, RMS of its steady errors, and RMS of their noise; shapes (n,).

    Raises:
        ValueError: The simulated steps are not the recorded ones.
    """
    settings = read_experiment(folder / "experiment.toml", recorded=True)
    nominal, reference = load_nominal(settings).map, paper_reference()
    recorded = read_step_log(folder / "steps.csv", nominal.space)
    last = recorded.iterations[-1]
    repeatable = simulation_of(settings).repeatable_plant(deployment_generator(settings.seed, last))
    if repeatable is None:
        raise ValueError(f"{folder}: plant '{settings.plant}' cannot repeat a step")
    plant = Repeating(repeatable, random_stream(settings.seed, last, 2))
    with threadpool_limits(limits=1, user_api="blas"):  # as in a run, otherwise the last digits differ
        learner = Run(folder).learner(last)
        with closing(deploy(learner, plant, reference, last)) as steps:
            simulated = Steps(nominal.space, steps)
    if digest(simulated) != digest(recorded.of_iteration(last)):
        raise ValueError(f"{folder}: deployment {last} could not be reproduced; use the versions that recorded it")
    steady = reference.steady
    errors = (simulated.planned().next_state - simulated.planned().target)[steady]
    return last, np.sqrt(np.mean(errors**2, axis=0)), np.sqrt(np.mean(np.array(plant.variances)[steady], axis=0))


def main() -> None:
    """Prints a line for each run: speed [mm/s] and height [mm]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=Path)
    for run in parser.parse_args().runs:
        last, errors, noise = floor(run)
        remaining = np.sqrt(np.maximum(errors**2 - noise**2, 0.0))
        named = {"steady error": errors, "noise": noise, "error of the map": remaining}
        parts = (f"{name} {1e3 * speed:.1f}, {1e3 * height:.2f}" for name, (speed, height) in named.items())
        print(f"{run.name}, deployment {last}: {'; '.join(parts)}", flush=True)


if __name__ == "__main__":
    main()
