"""How well does a walking robot do the velocity that it is told: as it is, with simple corrections, with StepGap?

A cell is a robot with a random gap (an individual with load, slope and friction) and a seed of its noise. It follows
its own reference, of some 100 steps,

- as it is: the command is the target;
- with a constant offset: the command is the target less the mean error of the run as it is;
- with an affine inverse: velocity = A command + b is fitted to the run as it is, and solved for the command;
- with an integrator, the command is the target plus the sum of all errors times a gain; the sum begins with that of a
  run before. Its gain, of 0.1, 0.2, 0.4 and 0.7, has the least error on other gaps;
- with StepGap, default settings, after one and two redeployments, and online in the first deployment and the next.

*Held* are errors from the third step after a change of target on, and *change* is the root mean square change of the
command there, from step to step, in half ranges of use: of a command that rings it is large.

Each has 100 steps of experience, but for the second redeployment, which has 200, and the first deployment online, which
has none. Errors are RMSE up to a fall, medians over the cells; the last column is the root of the mean square of all
errors in half ranges of use, and its ratio to the robot as it is.

    ./go python -m benchmarks.velocity --out velocity.jsonl [--robots velocity,FILE.toml] [--gaps 5] [--seeds 3]
        [--first-gap 1000] [--methods default,online]

A robot is a name, or a file of settings. `--out` receives a line of JSON for each cell as soon as it is done; cells in
it are not computed again.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.disturbed_plant import METHODS, finished, own_priors
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.experiment.settings import read_experiment
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.plant import Plant
from stepgap.robots.entry_points import load_robot
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepSpace, StepStatus

GAINS = (0.1, 0.2, 0.4, 0.7)
TUNING_GAPS = (1, 2, 3)
"""Gains of the integrator, and gaps on which one is chosen."""

Law = Callable[[Array, Array, Array], Array]
"""Command by the target, the state and the target before; shapes (n,)."""


class Cell(NamedTuple):
    """A robot by name or file, the number of its gap, and its seed."""

    robot: str
    gap: int
    seed: int


class Trip(NamedTuple):
    """A run.

    Attributes:
        commands: Shape (N, n).
        velocities: Measured at the end of each step; shape (N, n).
        targets: Shape (N, n).
        fell: Whether it ended before the last target.
    """

    commands: Array
    velocities: Array
    targets: Array
    fell: bool

    @property
    def errors(self) -> Array:
        return self.velocities - self.targets

    @property
    def changes(self) -> Array:
        """Changes of the command from the step before; the first is zero."""
        return np.diff(self.commands, axis=0, prepend=self.commands[:1])

    @property
    def held(self) -> NDArray[np.bool_]:
        """Steps whose target is that of the two steps before; shape (N,)."""
        same = np.append(False, (np.diff(self.targets, axis=0) == 0).all(axis=1))
        return same & np.append(False, same[:-1])


def robot_of(cell: Cell) -> Robot:
    """The robot of a cell."""
    named = Path(cell.robot)
    robot = read_experiment(named).robot if named.suffix == ".toml" else load_robot(cell.robot)
    found = robot.randomised(random_stream(cell.gap, 7))
    assert found is not None
    return found


def plant_of(robot: Robot, rng: np.random.Generator) -> Plant:
    """The simulated plant."""
    return next(iter(robot.simulations().values()))(rng).plant(rng)


def reference_of(robot: Robot) -> Reference:
    """The default reference."""
    return next(iter(robot.references().values()))()


def walked(cell: Cell, run: int, law: Law) -> Trip:
    """A run under a law, with the noise of its number."""
    robot = robot_of(cell)
    plant, space, targets = plant_of(robot, random_stream(cell.seed, run)), robot.space, reference_of(robot).targets
    state, before, rows = plant.start(), targets[0], list[tuple[Array, Array, Array]]()
    for target in targets:
        command = np.clip(law(target, state, before), space.command_lower, space.command_upper)
        record = plant.take_step(command)
        if record.status != StepStatus.OK:
            break
        rows.append((command, record.next_state, target))
        state, before = record.next_state, target
    commands, velocities, wanted = np.array(rows).reshape(-1, 3, len(space.state)).transpose(1, 0, 2)
    return Trip(commands, velocities, wanted, fell=len(rows) < len(targets))


class Integrator:
    """The target plus the sum of the errors times a gain, not beyond the range of the command.

    Args:
        space: Ranges.
        gain: The gain.
    """

    def __init__(self, space: StepSpace, gain: float):
        self._gain, self._most, self._sum = gain, space.command_scale, np.zeros(len(space.state))
        self._begun = False

    def __call__(self, target: Array, state: Array, before: Array) -> Array:
        if self._begun:
            self._sum = np.clip(self._sum + self._gain * (before - state), -self._most, self._most)
        self._begun = True
        return target + self._sum

    def again(self) -> "Integrator":
        """This one before another run."""
        self._begun = False
        return self


def integrated(cell: Cell, gain: float) -> Trip:
    """The second run of an integrator."""
    law = Integrator(robot_of(cell).space, gain)
    walked(cell, 0, law)
    return walked(cell, 1, law.again())


def error(walk: Trip, space: StepSpace) -> float:
    """Root of the mean square of the errors [half ranges]; a fall counts as one more error of a half range a step."""
    return size_of(walk.errors, space) + walk.fell


def size_of(values: Array, space: StepSpace) -> float:
    """Root of the mean square of velocities (N, n) [half ranges]."""
    return float(np.sqrt(np.mean((values / space.state_scale) ** 2)))


def best_gain(robot: str) -> float:
    """The gain of the integrator with the least error on the gaps of tuning."""
    cells, space = [Cell(robot, number, 0) for number in TUNING_GAPS], robot_of(Cell(robot, 1, 0)).space
    return min(GAINS, key=lambda gain: sum(error(integrated(cell, gain), space) for cell in cells))


def affine_inverse(walk: Trip) -> Law:
    """The command whose velocity is the target, by least squares over a run."""
    ones = np.ones((len(walk.commands), 1))
    found = np.linalg.lstsq(np.hstack([ones, walk.commands]), walk.velocities, rcond=None)[0]
    return lambda target, state, before: np.linalg.lstsq(found[1:].T, target - found[0], rcond=None)[0]


def learned(cell: Cell, method: str) -> list[Trip]:
    """The deployments of a run of StepGap."""
    robot, log = robot_of(cell), list[LoggedStep]()
    settings = replace(METHODS[method], iterations=2 if method == "default" else 1, early_stop=False)
    nominal = next(iter(robot.nominal_maps().values()))()
    plants, priors = Plants(partial(plant_of, robot)), own_priors(robot)
    setup = Setup(nominal, plants, reference_of(robot), settings, seed=cell.seed, priors=priors)
    with tempfile.TemporaryDirectory() as folder:
        run_experiment(setup, Path(folder), Observer(on_step=log.append))
    return [_walk(Steps(robot.space, log).of_iteration(k), setup.reference) for k in range(settings.iterations + 1)]


def _walk(steps: Steps, reference: Reference) -> Trip:
    done = np.isfinite(steps.next_state).all(axis=1)
    return Trip(steps.command[done], steps.next_state[done], steps.target[done], int(done.sum()) < len(reference))


def measure(cell: Cell, gain: float, methods: Sequence[str]) -> dict[str, Any]:
    """The row of a cell."""
    space = robot_of(cell).space
    as_it_is = walked(cell, 0, lambda target, state, before: target)
    bias = as_it_is.errors.mean(axis=0)
    walks = {
        "command = target": as_it_is,
        "constant offset": walked(cell, 1, lambda target, state, before: target - bias),
        "affine inverse": walked(cell, 1, affine_inverse(as_it_is)),
        "integrator": integrated(cell, gain),
    }
    for method in methods:
        for number, walk in enumerate(learned(cell, method)):
            walks[f"StepGap {method}, deployment {number}"] = walk
    found = {
        name: {
            "rmse": np.sqrt(np.mean(walk.errors**2, axis=0)).tolist(),
            "all": size_of(walk.errors, space),
            "held": size_of(walk.errors[walk.held], space),
            "change": size_of(walk.changes[walk.held], space),
            "fell": walk.fell,
        }
        for name, walk in walks.items()
    }
    return {"robot": cell.robot, "gap": cell.gap, "seed": cell.seed, "gain": gain, "walks": found}


def print_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints a table in Markdown for each robot."""
    for robot in dict.fromkeys(row["robot"] for row in rows):
        here = [row["walks"] for row in rows if row["robot"] == robot]
        space = robot_of(Cell(robot, 1, 0)).space
        units = " | ".join(f"{each.name} [{each.unit}]" for each in space.state)
        gain = next(row["gain"] for row in rows if row["robot"] == robot)
        print(f"\n{robot}, {len(here)} cells; gain of the integrator {gain}")
        print(f"| | {units} | all [half ranges] | of that as it is | held | change | falls |")
        print(f"|---|{'---|' * (len(space.state) + 5)}")
        for name in here[0]:
            rmse = " | ".join(f"{each:.3f}" for each in np.median([walks[name]["rmse"] for walks in here], axis=0))
            every, held, change = (np.median([walks[name][key] for walks in here]) for key in ("all", "held", "change"))
            ratio = np.median([walks[name]["all"] / walks["command = target"]["all"] for walks in here])
            falls = sum(walks[name]["fell"] for walks in here)
            print(f"| {name} | {rmse} | {every:.3f} | {ratio:.2f} | {held:.3f} | {change:.3f} | {falls} |")


def main() -> None:
    """Runs the cells that `--out` lacks, and prints the tables of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robots", default="velocity")
    parser.add_argument("--gaps", type=int, default=5)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first-gap", type=int, default=1000)
    parser.add_argument("--methods", default="default,online")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {(row["robot"], row["gap"], row["seed"]) for row in rows}
    with given.out.open("a", encoding="utf-8") as out:
        for robot in given.robots.split(","):
            numbers = product(range(given.seeds), range(given.first_gap, given.first_gap + given.gaps))
            cells = [Cell(robot, gap, seed) for seed, gap in numbers]
            waiting = [cell for cell in cells if cell not in done]
            if not waiting:
                continue
            known = [row["gain"] for row in rows if row["robot"] == robot]
            gain = known[0] if known else best_gain(robot)
            task = partial(measure, gain=gain, methods=given.methods.split(","))
            for _, row in finished(task, waiting):
                rows.append(row)
                print(json.dumps(row), file=out, flush=True)
    print_table(sorted(rows, key=lambda row: (row["robot"], row["gap"], row["seed"])))


if __name__ == "__main__":
    main()
