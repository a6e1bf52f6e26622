"""How well does a walking robot do the velocity that it is told: as it is, with simple corrections, with StepGap?

A cell is a robot with a random gap (an individual with load, slope, friction, delay and weak motors); gaps in which the
robot falls as it is are passed over. It follows its own reference, of some 100 steps,

- as it is: the command is the target;
- with a constant offset: the command is the target less the mean error of the run as it is;
- with an affine inverse: velocity = A command + b is fitted to the run as it is, and solved for the command;
- with an integrator, the command is the target plus the sum of all errors times a gain; the sum begins with that of a
  run before. *The better gain* of each cell is chosen in hindsight;
- with StepGap, after one and two redeployments, with warm starts of the first seconds of its first deployment, and
  online in the first deployment and the next;
- with an oracle, which tries the commands of two steps on copies of the simulation, as it truly is, before each step:
  what is left is what no command mends;
- with StepGap without one of its parts each, after one redeployment (`WITHOUT`).

Errors are those of the true velocities, RMSE up to a fall. *Held* are errors from the third step after a change of
target on, and *change* is the root mean square change of the command there, from step to step, in half ranges of use:
of a command that rings it is large.

    ./go python -m benchmarks.velocity --out velocity.jsonl [--robots velocity,FILE.toml] [--gaps 5] [--first-gap 1000]
        [--warm 15,30] [--online] [--oracle] [--without]

A robot is a name, or a file of settings, whose settings of control count. `--out` receives a line of JSON for each cell
as soon as it is done; cells in it are not computed again.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from dataclasses import replace
from functools import cache, partial
from itertools import count
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.disturbed_plant import METHODS, finished, own_priors
from stepgap.base.random_streams import random_stream
from stepgap.control.gauss_newton import minimise
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Observer, Plants, Setup, run_experiment
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot
from stepgap.plants.plant import Plant
from stepgap.robots.entry_points import load_robot
from stepgap.robots.nominal_maps.affine_map import AffineMap
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepSpace, StepStatus

GAINS = (0.1, 0.2, 0.4)
"""Gains of the integrator."""

APART, FLAT = 0.08, 0.03
"""The oracle's search: differences of commands [half ranges] that scatter of the gait does not spoil, and the share by
which a better plan must lower the cost."""
CALM = 0.1
"""Weight of its changes of command beside its errors, both in half ranges of use, as in the plans of a humanoid."""

COMMAND_BEFORE = "the command before"
WITHOUT: Mapping[str, Mapping[str, Any]] = {
    COMMAND_BEFORE: {},
    "the step after": {"horizon": 1},
    "caution": {"cautious": False},
    "widening": {"widening": inf},
    "surprise": {"surprise": inf},
    "largest_change": {"largest_change": 1.0},
}
"""Settings of control by which StepGap lacks a part; without the command before the space says that it is without."""

RAW, BETTER = "command = target", "integrator, the better gain"
"""Names of the run without correction, and of the better integrator of a cell."""

Law = Callable[[Array, Array, Array], Array]
"""Command by the target, the state and the target before; shapes (n,)."""


class Cell(NamedTuple):
    """A robot by name or file, and the number of its gap."""

    robot: str
    gap: int


class Trip(NamedTuple):
    """A run.

    Attributes:
        commands: Shape (N, n).
        velocities: True ones at the end of each step; shape (N, n).
        measured: The same as measured.
        targets: Shape (N, n).
        fell: Whether it ended before the last target.
    """

    commands: Array
    velocities: Array
    measured: Array
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


@cache
def experiment_of(robot: str) -> Experiment:
    """The settings of a robot by name or file."""
    file = Path(robot)
    return read_experiment(file) if file.suffix == ".toml" else Experiment(load_robot(robot))


def robot_of(cell: Cell) -> WalkingRobot:
    """The robot of a cell."""
    found = experiment_of(cell.robot).robot.randomised(random_stream(cell.gap, 7))
    assert isinstance(found, WalkingRobot)
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
    plant, space, targets = plant_of(robot, random_stream(cell.gap, run)), robot.space, reference_of(robot).targets
    state, before, rows = plant.start(), targets[0], list[tuple[Array, ...]]()
    for target in targets:
        command = np.clip(law(target, state, before), space.command_lower, space.command_upper)
        record = plant.take_step(command)
        if record.status != StepStatus.OK:
            break
        rows.append((command, record.true_next_state, record.next_state, target))
        state, before = record.next_state, target
    return _trip(rows, targets)


def _trip(rows: Sequence[tuple[Array, ...]], targets: Array) -> Trip:
    """A run by its rows: command, velocity, measured velocity and target."""
    columns = np.array(rows).reshape(-1, 4, targets.shape[1]).transpose(1, 0, 2)
    return Trip(*columns, fell=len(rows) < len(targets))


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
    """The second run of an integrator, or the first one if it fell there."""
    law = Integrator(robot_of(cell).space, gain)
    first = walked(cell, 0, law)
    return first if first.fell else walked(cell, 1, law.again())


def foreseen(cell: Cell) -> Trip:
    """The run of the oracle: the commands of two steps that are best on copies of the simulation, the first of them."""
    robot = robot_of(cell)
    space = robot.space
    plant = plant_of(robot, random_stream(cell.gap, 1))
    targets = reference_of(robot).targets
    plant.start()
    before = targets[0]
    plan = np.tile(space.point_of(before), 2)
    rows = list[tuple[Array, ...]]()
    for number, target in enumerate(targets):
        wanted = targets[[number, min(number + 1, len(targets) - 1)]]
        outcomes = partial(_shortcomings, plant, wanted, before, space)
        plan = minimise(outcomes, partial(_slopes, outcomes), plan, improvement=FLAT).point
        command = space.command_at(plan[: len(before)])
        record = plant.take_step(command)
        if record.status != StepStatus.OK:
            break
        rows.append((command, record.true_next_state, record.next_state, target))
        before = command
        plan = np.tile(plan[len(before) :], 2)
    return _trip(rows, targets)


def _shortcomings(plant: Plant, targets: Array, before: Array, space: StepSpace, plan: Array) -> Array:
    """Errors and changes of command of two steps of a copy of the simulation; large where it falls."""
    copied = deepcopy(plant)
    parts = list[Array]()
    for target, command in zip(targets, space.command_at(plan.reshape(2, -1)), strict=True):
        velocity = copied.take_step(command).true_next_state
        parts += [np.nan_to_num((velocity - target) / space.state_scale, nan=3.0)]
        parts += [CALM * (command - before) / space.state_scale]
        before = command
    return np.concatenate(parts)


def _slopes(outcomes: Callable[[Array], Array], plan: Array) -> Array:
    """Differences of outcomes by each command of a plan, inside of its bounds."""
    here = outcomes(plan)
    steps = np.diag(np.where(plan > 0, -APART, APART))
    return np.array([(outcomes(plan + step) - here) / step.sum() for step in steps]).T


def size_of(values: Array, space: StepSpace) -> float:
    """Root of the mean square of velocities (N, n) [half ranges]."""
    return float(np.sqrt(np.mean((values / space.state_scale) ** 2)))


def affine_inverse(walk: Trip) -> Law:
    """The command whose velocity is the target, by least squares over a run."""
    ones = np.ones((len(walk.commands), 1))
    found = np.linalg.lstsq(np.hstack([ones, walk.commands]), walk.measured, rcond=None)[0]
    return lambda target, state, before: np.linalg.lstsq(found[1:].T, target - found[0], rcond=None)[0]


def learned(cell: Cell, settings: LearningSettings, known: Steps | None = None, without: str = "") -> list[Steps]:
    """The deployments of a run of StepGap, with the settings of control of its file, without a part of `WITHOUT`."""
    robot, log = robot_of(cell), list[LoggedStep]()
    nominal = next(iter(robot.nominal_maps().values()))()
    if without == COMMAND_BEFORE:
        assert isinstance(nominal, AffineMap)
        nominal = replace(nominal, quantities=replace(nominal.space, is_lagged=False))
    plants, priors = Plants(partial(plant_of, robot)), own_priors(robot)
    control = replace(experiment_of(cell.robot).control, **WITHOUT.get(without, {}))
    setup = Setup(nominal, plants, reference_of(robot), settings, control, cell.gap, known, priors)
    with tempfile.TemporaryDirectory() as folder:
        run_experiment(setup, Path(folder), Observer(on_step=log.append))
    steps = Steps(robot.space, log)
    return [steps.of_iteration(number) for number in steps.iterations]


def trip_of(steps: Steps, reference: Reference) -> Trip:
    """A deployment of StepGap."""
    done = np.isfinite(steps.next_state).all(axis=1) & ~steps.unplanned
    columns = (steps.command, steps.true_next_state, steps.next_state, steps.target)
    return Trip(*(column[done] for column in columns), fell=int(done.sum()) < len(reference))


def measure(
    cell: Cell, warm: Sequence[float] = (), online: bool = False, oracle: bool = False, without: bool = False
) -> dict[str, Any]:
    """The row of a cell; without `walks` if the robot falls as it is.

    Args:
        cell: The cell.
        warm: Seconds of the first deployment that other runs begin with.
        online: Whether to learn online, too.
        oracle: Whether to measure the oracle, too.
        without: Whether to measure StepGap without each of its parts, too.
    """
    robot = robot_of(cell)
    space, reference = robot.space, reference_of(robot)
    row = {"robot": cell.robot, "gap": cell.gap}
    as_it_is = walked(cell, 0, lambda target, state, before: target)
    if as_it_is.fell:
        return row
    bias = (as_it_is.measured - as_it_is.targets).mean(axis=0)
    walks = {
        RAW: as_it_is,
        "constant offset": walked(cell, 1, lambda target, state, before: target - bias),
        "affine inverse": walked(cell, 1, affine_inverse(as_it_is)),
        **{f"integrator {gain:g}": integrated(cell, gain) for gain in GAINS},
    }
    settings = replace(METHODS["default"], iterations=2, early_stop=False)
    first, *redeployed = learned(cell, settings)
    for seconds in warm:
        known = first[: round(seconds / robot.walk.seconds)]
        walks[f"StepGap, {seconds:g} s known"] = trip_of(
            learned(cell, replace(settings, iterations=0), known)[-1], reference
        )
    walks |= {f"StepGap, redeployment {number}": trip_of(each, reference) for number, each in enumerate(redeployed, 1)}
    if online:
        both = learned(cell, replace(METHODS["online"], iterations=1, early_stop=False))
        walks |= {f"StepGap online, deployment {number}": trip_of(each, reference) for number, each in enumerate(both)}
    for part in WITHOUT if without else ():
        fewer = learned(cell, replace(settings, iterations=1), without=part)[-1]
        walks[f"StepGap without {part}, redeployment 1"] = trip_of(fewer, reference)
    if oracle:
        walks["oracle"] = foreseen(cell)
    found = {
        name: {
            "rmse": np.sqrt(np.mean(walk.errors**2, axis=0)).tolist(),
            "all": size_of(walk.errors, space),
            "held": size_of(walk.errors[walk.held], space),
            "change": size_of(walk.changes[walk.held], space),
            "steps": len(walk.errors),
            "fell": walk.fell,
        }
        for name, walk in walks.items()
    }
    return row | {"walks": found}


def print_tables(rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints a table in Markdown for each robot, and one of all."""
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    for robot in robots:
        print_table(robot, [with_better_gain(row["walks"]) for row in rows if row["robot"] == robot])
    if len(robots) > 1:
        print_table("all robots", [with_better_gain(row["walks"]) for row in rows])


def with_better_gain(walks: Mapping[str, Mapping[str, Any]]) -> dict[str, Mapping[str, Any]]:
    """The walks with that of the integrator whose gain was the better one of the cell."""
    integrators = [walk for name, walk in walks.items() if name.startswith("integrator")]
    return {**walks, BETTER: min(integrators, key=lambda walk: (walk["fell"], walk["all"]))}


def print_table(title: str, cells: Sequence[Mapping[str, Mapping[str, Any]]]) -> None:
    """Prints what was measured in some cells: mean, median and worst ratios, and means of the others."""
    print(f"\n{title}, {len(cells)} cells; in half ranges of use")
    print("| | error | of that as it is: mean, median, worst | of the integrator's | held | change | falls |")
    print("|---|---|---|---|---|---|---|")
    for name in [name for name in cells[0] if all(name in walks for walks in cells)]:
        here = [walks[name] for walks in cells]
        ratios = np.array([walks[name]["all"] / walks[RAW]["all"] for walks in cells])
        others = np.array([walks[name]["all"] / walks[BETTER]["all"] for walks in cells])
        every, held, change = (np.mean([walk[key] for walk in here]) for key in ("all", "held", "change"))
        falls = sum(walk["fell"] for walk in here)
        shares = f"{ratios.mean():.2f}, {np.median(ratios):.2f}, {ratios.max():.2f}"
        both = f"{others.mean():.2f}, {np.median(others):.2f}, {others.max():.2f}"
        print(f"| {name} | {every:.3f} | {shares} | {both} | {held:.3f} | {change:.3f} | {falls} |")


def main() -> None:
    """Runs the cells that `--out` lacks, and prints the tables of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robots", default="velocity")
    parser.add_argument("--gaps", type=int, default=5, help="number of gaps of each robot in which it walks as it is")
    parser.add_argument("--first-gap", type=int, default=1000)
    parser.add_argument("--warm", default="", help="seconds of the first deployment that other runs begin with")
    parser.add_argument("--online", action="store_true")
    parser.add_argument("--oracle", action="store_true", help="some minutes a cell")
    parser.add_argument("--without", action="store_true", help="StepGap without each of its parts")
    given = parser.parse_args()
    warm = [float(each) for each in given.warm.split(",") if each]
    rows: list[dict[str, Any]] = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    task = partial(measure, warm=warm, online=given.online, oracle=given.oracle, without=given.without)
    with given.out.open("a", encoding="utf-8") as out:
        for robot in given.robots.split(","):
            done = {row["gap"] for row in rows if row["robot"] == robot}
            gaps = (gap for gap in count(given.first_gap) if gap not in done)
            while (lacking := given.gaps - sum("walks" in row for row in rows if row["robot"] == robot)) > 0:
                for _, row in finished(task, [Cell(robot, next(gaps)) for _ in range(lacking)]):
                    rows.append(row)
                    print(json.dumps(row), file=out, flush=True)
    walked_rows = [row for row in rows if "walks" in row]
    print_tables(sorted(walked_rows, key=lambda row: (row["robot"], row["gap"])))
    for row in rows:
        if "walks" not in row:
            print(f"{row['robot']}, gap {row['gap']}: it falls as it is, and is not counted")


if __name__ == "__main__":
    main()
