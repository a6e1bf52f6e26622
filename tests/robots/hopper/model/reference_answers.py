"""Stored results of `reference_hop`, which takes most of a second for each hop.

`./go python -m tests.robots.hopper.model.reference_answers` computes all of them and writes `reference_answers.json`.
That is needed after a change of `CASES`, of a default of the robot or of its gains, or of `reference_hop`.
`test_apex_map` computes a random sample again in every run.
"""

import json
from collections.abc import Iterator
from dataclasses import asdict
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stepgap.robots.hopper import CommandBounds, Gains, RobotParameters
from stepgap.step import Array, StepStatus
from tests.robots.hopper.model.reference_hop import Hopper, reference_hop

FILE = Path(__file__).with_name("reference_answers.json")
COMMAND_LINE = "./go python -m tests.robots.hopper.model.reference_answers"
WIDE = np.array([[-3.0, 0.1, -300.0, -300.0], [3.0, 1.5, 300.0, 300.0]])


class Case(NamedTuple):
    """A robot and its hops; `points` are (speed, height, fx, fy), shape (N, 4)."""

    robot: RobotParameters
    gains: Gains
    points: Array

    def inputs(self) -> dict[str, Any]:
        """All inputs of the answers, as JSON data."""
        return {"robot": asdict(self.robot), "gains": asdict(self.gains), "points": self.points.tolist()}


class Answer(NamedTuple):
    """Result of the reference for one hop; the next state is NaN where there is none."""

    status: StepStatus
    next_state: Array


def points_of_use(seed: int, count: int) -> Array:
    """Random (speed, height, fx, fy) within the ranges."""
    space = CommandBounds().space()
    quantities = (*space.state, *space.command)
    lower, upper = [quantity.lower for quantity in quantities], [quantity.upper for quantity in quantities]
    return np.random.default_rng(seed).uniform(lower, upper, (count, 4))


def wide_points(seed: int, count: int) -> Array:
    """Random points far outside the ranges, where most hops fail."""
    return np.random.default_rng(seed).uniform(WIDE[0], WIDE[1], (count, 4))


ROBOT, GAINS = RobotParameters(), Gains()
CASES = {
    "range of use": Case(ROBOT, GAINS, points_of_use(11, 12)),
    "saturated motors": Case(RobotParameters(torque_limit=10.0), GAINS, points_of_use(12, 6)),
    "soft spring": Case(ROBOT, Gains(stiffness=1800.0), points_of_use(13, 3)),
    "stiff spring": Case(ROBOT, Gains(stiffness=3500.0), points_of_use(13, 3)),
    "far outside": Case(ROBOT, GAINS, wide_points(14, 15)),
    "tight tolerances": Case(ROBOT, GAINS, points_of_use(15, 4)),
    "pulling spring": Case(ROBOT, Gains(rest_length=0.2, landing_length=0.3), points_of_use(18, 6)),
    "heavy legs": Case(
        RobotParameters(bottom_mass=2.0, body_mass=0.05, boom_inertia_vertical=0.0, torque_limit=8.0),
        Gains(2539.0, 0.2718, 0.2716, speed_gain=0.173, position_gain=61.6, damping_gain=2.414),
        np.array([[1.567, 0.2998, -74.8, 10.1], [-2.17, 0.302, -118.0, -161.0]]),
    ),
}


def compute_answer(case: Case, point: Array) -> Answer:
    """Computes the reference at one point (speed, height, fx, fy)."""
    return Answer(*reference_hop(Hopper(case.robot, case.gains), point[:2], point[2:]))


@cache
def _stored() -> dict[str, Any]:
    return json.loads(FILE.read_text("utf-8"))


def stored_answers(name: str) -> list[Answer]:
    """Answers at the points of a case; an error if they were computed for other numbers."""
    kept = _stored()[name]
    assert kept["inputs"] == CASES[name].inputs(), f"the answers of '{name}' are out of date: run {COMMAND_LINE}"
    return [Answer(StepStatus(status), np.array(state, float)) for status, state in kept["answers"]]


def _as_json(answers: Iterator[Answer]) -> list[list[Any]]:
    """Answers as JSON data; a missing number is null."""
    return [[int(status), [float(x) if np.isfinite(x) else None for x in state]] for status, state in answers]


def write_answers() -> None:
    """Computes the answers of all cases and writes them to `FILE`, one case per line."""
    lines = []
    for name, case in CASES.items():
        answers = _as_json(compute_answer(case, point) for point in case.points)
        lines.append(f"{json.dumps(name)}: {json.dumps({'inputs': case.inputs(), 'answers': answers})}")
    FILE.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")


if __name__ == "__main__":
    write_answers()
