"""Does a walking robot walk straight on, and stand still? As it is, with the learned map, and with `control.make_up`.

A robot with a random gap walks its default reference as it is, which is what is learned from. Then it walks 20 m
straight on at 0.3 and at 0.6 m/s, and is told to stand for 30 s. What it is told of its pose is true up to 1 cm and
5 mrad; what is printed is true: way, distance from the line and heading, at the end and the largest of the walk.

    ./go python -m benchmarks.straight --out straight.jsonl --robots velocity,FILE.toml --gaps 94001

A robot is a name, or a file of settings, as in `benchmarks.velocity`. `--make-up` are numbers of steps to try.
"""

import argparse
import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.disturbed_plant import METHODS
from benchmarks.velocity import Cell, experiment_of, plant_of, reference_of, robot_of
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.control.settings import ControlSettings
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.step import Array, StepRecord, StepSpace

WAY, SPEEDS, STANDING = 20.0, (0.3, 0.6), 30.0
"""Length of a walk [m], its speeds [m/s], and for how long a robot is told to stand [s]."""
POSE_NOISE = np.array([0.01, 0.01, 0.005])
"""Standard deviation of the measured pose [m, m, rad]."""


class MeasuredPose(Plant):
    """A plant whose measured pose is noisy; it keeps the true one.

    Args:
        plant: The plant itself.
        rng: Draws the noise.
    """

    def __init__(self, plant: Plant, rng: np.random.Generator):
        self._plant, self._rng = plant, rng
        self.poses = list[Array]()

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the plant."""
        return self._plant.space

    def start(self) -> Array:
        """Starts the plant."""
        return self._plant.start()

    def take_step(self, command: Array) -> StepRecord:
        """A step of the plant."""
        record = self._plant.take_step(command)
        pose = np.array([record.context[name] for name in self.space.pose_names])
        self.poses.append(pose)
        noisy = pose + POSE_NOISE * self._rng.standard_normal(3)
        return replace(record, context=dict(zip(self.space.pose_names, noisy.tolist(), strict=True)))

    def stop(self) -> None:
        """Stops the plant."""
        self._plant.stop()


def walked_to(cell: Cell, run: int, learner: Learner | None, reference: Reference, make_up: int) -> dict[str, Any]:
    """A walk with a learner and its settings of control; without one the command is the target."""
    robot = robot_of(cell)
    plant = MeasuredPose(plant_of(robot, random_stream(cell.gap, run)), random_stream(cell.gap, run, 2))
    control = replace(experiment_of(cell.robot).control, make_up=make_up)
    if learner is None:
        steps = list(as_told(plant, reference))
    else:
        steps = [logged.record for logged in deploy(learner, plant, reference, learner.iteration, 0, control)]
    x, y, heading = np.array(plant.poses).T
    heading = np.degrees(np.unwrap(heading))
    return {
        "way": x[-1],
        "lateral": [y[-1], float(np.abs(y).max())],
        "heading": [heading[-1], float(np.abs(heading).max())],
        "fell": len(steps) < len(reference),
    }


def as_told(plant: Plant, reference: Reference) -> list[StepRecord]:
    """The steps of a plant whose commands are the targets, up to a fall."""
    plant.start()
    steps = list[StepRecord]()
    for target in reference.targets:
        record = plant.take_step(target)
        if not np.isfinite(record.next_state).all():
            break
        steps.append(record)
    return steps


def measure(cell: Cell, make_ups: Sequence[int]) -> dict[str, Any]:
    """The row of a cell."""
    robot = robot_of(cell)
    space, seconds = robot.space, robot.walk.seconds
    nominal = next(iter(robot.nominal_maps().values()))()
    first = Learner.start(nominal, Steps(space), METHODS["default"], 0)
    plant = plant_of(robot, random_stream(cell.gap, 0))
    known = Steps(space, deploy(first, plant, reference_of(robot), 0, 0, ControlSettings()))
    learner = Learner.start(nominal, known, METHODS["default"], 1)
    row = dict[str, Any]()
    for speed in (*SPEEDS, 0.0):
        count = round((WAY / speed if speed else STANDING) / seconds)
        reference = Reference(space.state_names, np.tile([speed, 0.0, 0.0], (count, 1)))
        walks = {"as it is": walked_to(cell, 1, None, reference, 0)}
        for make_up in make_ups:
            walks[f"make_up = {make_up}"] = walked_to(cell, 1, learner, reference, make_up)
        row[f"{speed:g} m/s"] = walks
    return {"robot": cell.robot, "gap": cell.gap, "walks": row}


def print_table(rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints a table in Markdown."""
    print("| | gap | | way [m] | lateral, largest [m] | heading, largest [°] | |\n|---|---|---|---|---|---|---|")
    for row in rows:
        for speed, walks in row["walks"].items():
            for name, walk in walks.items():
                lateral = "{:.2f}, {:.2f}".format(*walk["lateral"])
                heading = "{:.1f}, {:.1f}".format(*walk["heading"])
                fell = "fell" if walk["fell"] else ""
                where = f"{row['robot']} | {row['gap']} | {speed}, {name}"
                print(f"| {where} | {walk['way']:.2f} | {lateral} | {heading} | {fell} |")


def main() -> None:
    """Runs the cells that `--out` lacks, and prints the table of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robots", default="velocity")
    parser.add_argument("--gaps", default="94001")
    parser.add_argument("--make-up", default="0,6")
    given = parser.parse_args()
    rows: list[dict[str, Any]] = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {(row["robot"], row["gap"]) for row in rows}
    cells = [Cell(robot, int(gap)) for robot in given.robots.split(",") for gap in given.gaps.split(",")]
    with given.out.open("a", encoding="utf-8") as out, one_blas_thread():
        for cell in cells:
            if cell not in done:
                rows.append(measure(cell, [int(each) for each in given.make_up.split(",")]))
                print(json.dumps(rows[-1]), file=out, flush=True)
    print_table(rows)


if __name__ == "__main__":
    main()
