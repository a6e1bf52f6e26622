"""A walking robot cured by a log: the simulated trot, driven by hand for some minutes, and then corrected.

    ./go python -m benchmarks.cure --minutes 2 5 10 --seeds 11 12 13 --out cure.jsonl
    ./go python -m benchmarks.cure --odometry late jitter gaps drift world --minutes 5 --seeds 11 --out odometry.jsonl

Each seed is a random individual (`WalkingGap.random`). Then it follows the 102 targets of the robot `velocity`: without
correction, with that of the log, and with that of one deployment of these targets ("one redeployment"). Errors are of
the true mean velocities of steps of 0.5 s, in half ranges of use. docs/velocity.md has what this gave.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import argparse
import json
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.odometry_log import Walking, driven
from stepgap.base.errors import InputError
from stepgap.control.settings import ControlSettings
from stepgap.cure.cure_folder import filter_numbers
from stepgap.cure.drive import read_drive
from stepgap.cure.lesson import lesson_of
from stepgap.cure.response import response_of
from stepgap.cure.velocity_filter import FilterSettings, VelocityFilter
from stepgap.export.controller.model_document import model_document
from stepgap.export.controller.portable_controller import portable_form
from stepgap.export.controller.step_filter import StepFilter
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.mujoco_robots.velocity.robot import TrottingRobot
from stepgap.mujoco_robots.velocity.walking_robot import WalkingGap, walks
from stepgap.step import Array

TICK, STEP = 0.02, 0.5
"""Time between two samples of the odometry, and that of a step [s]."""

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


class Robot(Walking):
    """A random individual, with an odometry of some kind."""

    def __init__(self, seed: int, kind: str, rng: np.random.Generator):
        robot = TrottingRobot()
        gap = WalkingGap.random(np.random.default_rng(seed))
        super().__init__(rng, replace(robot, gap=gap))
        self._odometry = ODOMETRY[kind]()
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


def drive_by_hand(seed: int, kind: str, minutes: float, folder: Path) -> str:
    """Writes a log; the text with which it is read."""
    rng = np.random.default_rng(1000 + seed)
    robot = Robot(seed, kind, rng)
    sent, command = driven(rng)
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
    return f"{folder}/odom.csv+{folder}/cmd.csv"


def followed(seed: int, kind: str, commanded: VelocityFilter | None, turned: bool) -> tuple[Array, Array, Array, int]:
    """Targets, true and measured mean velocities, each (102, 3), and the number of the step in which it fell, or 0."""
    rng = np.random.default_rng(2000 + seed)
    robot = Robot(seed, kind, rng)
    targets = walks(TrottingRobot().space).targets
    true, measured = np.full((len(targets), 3), np.nan), np.full((len(targets), 3), np.nan)
    for number, target in enumerate(np.vstack([np.zeros((2, 3)), targets]), -2):
        velocities, rows = list[Array](), list[Array]()
        for _ in range(round(STEP / TICK)):
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


def error(targets: Array, done: Array, fell: int) -> float:
    """Root mean square of all errors in half ranges of use, up to a fall."""
    scaled = (done - targets)[: fell or None] / TrottingRobot().space.state_scale
    return float(np.sqrt(np.nanmean(scaled**2)))


def redeployed(seed: int, kind: str) -> tuple[float, int]:
    """Error after one deployment of the same targets was learned from."""
    targets, _, measured, fell = followed(seed, kind, None, False)
    robot = TrottingRobot()
    count = fell - 1 if fell else len(targets)
    state = np.vstack([np.zeros((1, 3)), measured[: count - 1]])
    steps = Steps.of_columns(
        robot.space, state=state, command=targets[:count], next_state=measured[:count], target=targets[:count]
    )
    nominal: Any = robot.nominal_maps()["lag"]()
    learner = Learner.start(nominal, steps, LearningSettings(), 1)
    form = portable_form(learner, ControlSettings(horizon=1), np.random.default_rng(0), {}, "a deployment")
    limits = np.maximum(np.abs(robot.space.command_lower), np.abs(robot.space.command_upper))
    settings = FilterSettings(seconds=STEP, limits=tuple(limits.tolist()), stale=1.0)
    after, true, _, fell_then = followed(seed, kind, VelocityFilter(StepFilter(model_document(form)), settings), False)
    return error(after, true, fell_then), fell_then


def cured(seed: int, kind: str, minutes: float) -> dict[str, Any]:
    """What the cure by a log gives."""
    with tempfile.TemporaryDirectory() as name:
        try:
            drive = read_drive(drive_by_hand(seed, kind, minutes, Path(name)))
            response = response_of(drive)
            lesson = lesson_of([drive], response)
        except InputError as refusal:
            return {"refused": str(refusal).replace(name, "")}
    share, half = lesson.held.correctable(lesson.space.state_scale, lesson.driven)
    form = portable_form(lesson.learner, lesson.control, np.random.default_rng(0), {}, "a log")
    numbers = filter_numbers(lesson)
    correction = VelocityFilter(StepFilter(model_document(form)), FilterSettings(**numbers))
    targets, true, _, fell = followed(seed, kind, correction, drive.is_turned)
    return {
        "cured": error(targets, true, fell),
        "fell": fell,
        "steps": len(lesson.steps),
        "share": share,
        "half": half,
        "delay": response.delay,
        "period": response.period,
        "notes": drive.notes,
    }


def main() -> None:
    """Writes a line of JSON for each cell."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--minutes", type=float, nargs="+", default=[2.0, 5.0, 10.0])
    parser.add_argument("--seeds", type=int, nargs="+", default=[11])
    parser.add_argument("--odometry", nargs="+", default=["perfect"], choices=list(ODOMETRY))
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    with given.out.open("a", encoding="utf-8") as out:
        for seed in given.seeds:
            for kind in given.odometry:
                targets, true, _, fell = followed(seed, kind, None, False)
                # What happens to odometry in the frame of the world has no meaning for a deployment.
                again, fell_again = redeployed(seed, "perfect" if kind == "world" else kind)
                cell = {"seed": seed, "odometry": kind, "raw": error(targets, true, fell), "raw_fell": fell}
                cell |= {"redeployed": again, "redeployed_fell": fell_again}
                for minutes in given.minutes:
                    line = cell | {"minutes": minutes} | cured(seed, kind, minutes)
                    print(json.dumps(line, default=list), file=out, flush=True)
                    print(json.dumps(line, default=list), flush=True)


if __name__ == "__main__":
    main()
