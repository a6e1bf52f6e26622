"""A walking robot cured by a log: driven by hand for some minutes, and then corrected.

    ./go python -m benchmarks.cure --minutes 2 5 10 --seeds 11 12 13 --out cure.jsonl
    ./go python -m benchmarks.cure --odometry late jitter gaps drift world --minutes 5 --seeds 11 --out odometry.jsonl
    ./go python -m benchmarks.cure --robots velocity,dog/experiment.toml --minutes 2 5 --seeds 31 32 --out dogs.jsonl

A robot is a name, or a file of settings; by default the simulated trot. Each seed is a random individual of it. It is
driven by random commands, and then follows its 102 targets: without correction, with that of the log, and with that of
one deployment of these targets ("one redeployment"). Errors are of the true mean velocities of steps of its own
duration, in half ranges of use. docs/velocity_results.md has what this gave.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.odometry_log import TICK, Walking, driven
from benchmarks.velocity import experiment_of, reference_of
from stepgap.base.errors import InputError
from stepgap.cure.cure_folder import filter_numbers
from stepgap.cure.drive import read_drive
from stepgap.cure.habits import within_reach
from stepgap.cure.lesson import lesson_of
from stepgap.cure.response import response_of
from stepgap.cure.velocity_filter import FilterSettings, VelocityFilter
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.portable_controller import portable_form
from stepgap.export.controller.step_filter import StepFilter
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot
from stepgap.step import Array

Odometry = Callable[[Array, np.random.Generator], Array | None]
"""What odometry makes of a row of time, velocities and pose; None where it is silent."""


def perfect(row: Array, rng: np.random.Generator) -> Array | None:
    """As it is."""
    return row


class Late:
    """By 100 ms, or by another time each."""

    def __init__(self, least: float, most: float):
        self._least, self._most = least, most

    def __call__(self, row: Array, rng: np.random.Generator) -> Array | None:
        return np.append(row[0] + rng.uniform(self._least, self._most), row[1:])


class Gaps:
    """Silence of 0.2 to 1.5 s, every ten seconds or so."""

    def __init__(self) -> None:
        self._until = 0.0

    def __call__(self, row: Array, rng: np.random.Generator) -> Array | None:
        if rng.uniform() < TICK / 10:
            self._until = row[0] + rng.uniform(0.2, 1.5)
        return None if row[0] < self._until else row


class Drift:
    """Velocities whose zero walks by some 0.03 m/s and 0.02 rad/s a minute."""

    def __init__(self) -> None:
        self._bias = np.zeros(3)

    def __call__(self, row: Array, rng: np.random.Generator) -> Array | None:
        self._bias += np.array([0.03, 0.03, 0.02]) * np.sqrt(TICK / 60) * rng.standard_normal(3)
        return np.concatenate([row[:1], row[1:4] + self._bias, row[4:]])


def in_world(row: Array, rng: np.random.Generator) -> Array | None:
    """Velocities in the frame of the world."""
    cosine, sine = np.cos(row[6]), np.sin(row[6])
    return np.concatenate([row[:1], [cosine * row[1] - sine * row[2], sine * row[1] + cosine * row[2]], row[3:]])


ODOMETRY: dict[str, Callable[[], Odometry]] = {
    "perfect": lambda: perfect,
    "late": lambda: Late(0.1, 0.1),
    "later": lambda: Late(0.2, 0.2),
    "jitter": lambda: Late(0.05, 0.2),
    "gaps": Gaps,
    "drift": Drift,
    "world": lambda: in_world,
}
"""Kinds of odometry by name."""


class Case(NamedTuple):
    """A robot by name or file, the number of its individual, and the kind of its odometry."""

    name: str
    seed: int
    kind: str

    @property
    def robot(self) -> WalkingRobot:
        """The individual."""
        found = experiment_of(self.name).robot.randomised(np.random.default_rng(self.seed))
        assert isinstance(found, WalkingRobot)
        return found


class Robot(Walking):
    """A random individual, with an odometry of some kind."""

    def __init__(self, case: Case, rng: np.random.Generator):
        super().__init__(rng, case.robot)
        self._odometry = ODOMETRY[case.kind]()
        self._waiting = list[Array]()
        self._noise = rng

    def moved(self) -> list[Array]:
        """Moves for a tick; the rows of odometry that have come, with the times at which they did."""
        row = self._odometry(self.odometry(), self._noise)
        if row is not None:
            self._waiting.append(row)
        come = [row for row in self._waiting if row[0] <= self.time + 1e-9]
        self._waiting = [row for row in self._waiting if row[0] > self.time + 1e-9]
        return come


def drive_by_hand(case: Case, minutes: float, folder: Path) -> tuple[str, float]:
    """Writes a log; the text with which it is read, and the time at which the robot fell or the log ended [s]."""
    rng = np.random.default_rng(1000 + case.seed)
    robot = Robot(case, rng)
    sent, command = driven(rng, case.robot.space)
    inside = sent < 60 * minutes
    sent, command = sent[inside], command[inside]
    rows, due = list[Array](), 0
    while robot.time < 60 * minutes and not robot.fell:
        while due < len(sent) and sent[due] <= robot.time + 1e-9:
            robot.send(command[due])
            due += 1
        rows += robot.moved()
    odometry = np.array(rows)
    odometry[:, 0] = np.maximum.accumulate(odometry[:, 0])
    sent = TICK * np.ceil(sent / TICK - 1e-9)
    for name, table, header in (
        ("odom.csv", odometry, "time,vx,vy,wz,x,y,yaw"),
        ("cmd.csv", np.column_stack([sent, command]), "time,command_vx,command_vy,command_wz"),
    ):
        np.savetxt(folder / name, table, delimiter=",", header=header, comments="", fmt="%.6f")
    return f"{folder}/odom.csv+{folder}/cmd.csv", robot.time


def followed(case: Case, commanded: VelocityFilter | None, turned: bool) -> tuple[Array, Array, Array, int]:
    """Targets, true and measured mean velocities, each (102, 3), and the number of the step in which it fell, or 0."""
    rng = np.random.default_rng(2000 + case.seed)
    robot = Robot(case, rng)
    targets, ticks = reference_of(case.robot).targets, case.robot.walk.seconds / TICK
    true, measured = np.full((len(targets), 3), np.nan), np.full((len(targets), 3), np.nan)
    for number, target in enumerate(np.vstack([np.zeros((2, 3)), targets]), -2):
        velocities, rows = list[Array](), list[Array]()
        for _ in range(round((number + 3) * ticks) - round((number + 2) * ticks)):
            sent = np.array(commanded.command(robot.time, target)) if commanded else target
            robot.send(sent)
            for row in robot.moved():
                rows.append(row)
                if commanded:
                    cosine, sine = np.cos(row[6]), np.sin(row[6])
                    x, y, turning = row[1:4]
                    seen = (cosine * x + sine * y, cosine * y - sine * x, turning) if turned else (x, y, turning)
                    commanded.odometry(robot.time, seen)
            velocities.append(robot.velocity())
        if number >= 0:
            true[number] = np.mean(velocities, axis=0)
            measured[number] = np.mean([row[1:4] for row in rows], axis=0) if rows else np.nan
        if robot.fell:
            return targets, true, measured, number + 1
    return targets, true, measured, 0


def error(case: Case, targets: Array, done: Array, fell: int) -> float:
    """Root mean square of all errors in half ranges of use, up to a fall."""
    scaled = (done - targets)[: fell or None] / case.robot.space.state_scale
    return float(np.sqrt(np.nanmean(scaled**2)))


def redeployed(case: Case) -> tuple[float, int]:
    """Error after one deployment of the same targets was learned from."""
    targets, _, measured, fell = followed(case, None, False)
    robot = case.robot
    count = fell - 1 if fell else len(targets)
    state = np.vstack([np.zeros((1, 3)), measured[: count - 1]])
    steps = Steps.of_columns(
        robot.space, state=state, command=targets[:count], next_state=measured[:count], target=targets[:count]
    )
    nominal: Any = robot.nominal_maps()["lag"]()
    learner = Learner.start(nominal, steps, LearningSettings(), 1)
    control = replace(experiment_of(case.name).control, horizon=1)
    form = portable_form(learner, control, np.random.default_rng(0), {}, "a deployment")
    limits = np.maximum(np.abs(robot.space.command_lower), np.abs(robot.space.command_upper))
    settings = FilterSettings(seconds=robot.walk.seconds, limits=tuple(limits.tolist()), stale=1.0)
    after, true, _, fell_then = followed(case, VelocityFilter(StepFilter(model_document(form)), settings), False)
    return error(case, after, true, fell_then), fell_then


def cured(case: Case, minutes: float) -> dict[str, Any]:
    """What the cure by a log gives."""
    with tempfile.TemporaryDirectory() as name:
        try:
            text, seconds = drive_by_hand(case, minutes, Path(name))
            drive = read_drive(text)
            response = response_of(drive)
            lesson = lesson_of([drive], response)
        except InputError as refusal:
            return {"refused": str(refusal).replace(name, "")}
    share, half = lesson.held.correctable(lesson.space.state_scale, lesson.driven)
    form = portable_form(lesson.learner, lesson.control, np.random.default_rng(0), {}, "a log")
    numbers = filter_numbers(lesson)
    correction = VelocityFilter(StepFilter(model_document(form)), FilterSettings(**numbers))
    targets, true, _, fell = followed(case, correction, drive.is_turned)
    return {
        "cured": error(case, targets, true, fell),
        "fell": fell,
        "seconds": seconds,
        "steps": len(lesson.steps),
        "share": share,
        "half": half,
        "delay": response.delay,
        "lag": response.lag,
        "period": response.period,
        "height": response.height,
        "step": response.step,
        "zero": numbers["zero"],
        "reach": within_reach(lesson),
        "notes": drive.notes,
    }


def main() -> None:
    """Writes a line of JSON for each cell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--robots", default="velocity", help="names or files of settings, separated by commas")
    parser.add_argument("--minutes", type=float, nargs="+", default=[2.0, 5.0, 10.0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[11])
    parser.add_argument("--odometry", nargs="+", default=["perfect"], choices=list(ODOMETRY))
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    cases = [Case(*parts) for parts in product(given.robots.split(","), given.seeds, given.odometry)]
    with given.out.open("a", encoding="utf-8") as out:
        for case in cases:
            targets, true, _, fell = followed(case, None, False)
            # What happens to odometry in the frame of the world has no meaning for a deployment.
            again, fell_again = redeployed(case._replace(kind="perfect") if case.kind == "world" else case)
            cell = {"robot": case.name, "seed": case.seed, "odometry": case.kind}
            cell |= {"raw": error(case, targets, true, fell), "raw_fell": fell}
            cell |= {"redeployed": again, "redeployed_fell": fell_again}
            for minutes in given.minutes:
                line = cell | {"minutes": minutes} | cured(case, minutes)
                print(json.dumps(line, default=list), file=out, flush=True)
                print(json.dumps(line, default=list), flush=True)


if __name__ == "__main__":
    main()
