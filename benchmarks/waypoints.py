"""Waypoints with punches: does a correction between a waypoint law and a walking policy bring the robot nearer?

The task is rhoyn/teleop-walking-benchmark, built again from its description: every 5 s there is another waypoint, at
random in a disc of radius 1 m, with a random heading. A law with the gains 1.5/s commands velocities 50 times a second;
within 0.1 m and 0.05 rad it commands none, up to 0.2 m and 0.12 rad. Each 5 s begin with a punch: a random force for
0.08 s at a random joint, half to all of a ceiling that rises from a third of `--force` to all of it within 60 s. What
differs from theirs: the policies move the arms, too, the robot begins in its start posture, without a crane, and its
model is that of the policy with a random gap. So no number of this belongs into their table.

Between the waypoint law and the policy stands nothing, the affine inverse of one walk, or the filter that StepGap
exports after the same walk and one redeployment. The filter plans once a step, for the velocity that is wanted at its
begin; until the next step, changes of what is wanted are added to its command.

    ./go python -m benchmarks.waypoints --robots dog/experiment.toml --out waypoints.jsonl [--gaps 3]
        [--first-gap 95001] [--tours 3] [--force 500]

A line of JSON in `--out` is one tour: its errors of place and heading at the end of each waypoint that was reached
alive, and the time that it survived. The tables have means over tours, and ratios to nothing between with intervals of
95 % over individuals.
"""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

import argparse
import json
import tempfile
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np

import stepgap
from benchmarks.ratios import ratio
from benchmarks.velocity import Cell, Trip, affine_inverse, robot_of, walked
from stepgap.base.random_streams import random_stream
from stepgap.control.shortfall import turned
from stepgap.export.controller.model_document import model_text
from stepgap.export.controller.portable_controller import portable_controller
from stepgap.export.controller.step_filter import StepFilter
from stepgap.mujoco_robots.velocity.walking_robot import WalkingRobot, body_velocity
from stepgap.step import Array

WAYPOINTS = 18
POINT_SECONDS = 5.0
RADIUS = 1.0
AHEAD = 0.3  # The middle of the disc is this far ahead of the start [m]
GAIN = 1.5  # Of the waypoint law, for place and heading [1/s]
REACHED = (0.10, 0.20)  # Distance at which the law stops, and at which it begins again [m]
TURNED = (0.05, 0.12)  # The same for the heading [rad]
PERIOD = 0.02  # Of the waypoint law [s]
PUNCH_DELAY = 0.1
PUNCH_SECONDS = 0.08
RISE_SECONDS = 60.0  # Time in which the ceiling of the punches rises from a third to all of it [s]

Corrector = Callable[[Array, Array, bool], Array]
"""Command by the wanted velocity, the mean velocity of the latest step, and whether a step begins; shapes (3,)."""


class Tour(NamedTuple):
    """Waypoints and punches.

    Attributes:
        points: x, y and heading of each waypoint, from the pose at the start; shape (WAYPOINTS, 3) [m, m, rad].
        forces: Of the punch at the begin of each; shape (WAYPOINTS, 3) [N].
        bodies: Share of the bodies up to the one that is hit; shape (WAYPOINTS,).
    """

    points: Array
    forces: Array
    bodies: Array


class Walked(NamedTuple):
    """How a tour went.

    Attributes:
        seconds: Time until a fall, or of the whole tour [s].
        place: Distance from each waypoint that was reached alive, at its end [m].
        heading: Error of the heading there [rad].
    """

    seconds: float
    place: list[float]
    heading: list[float]


def tour_of(rng: np.random.Generator, force: float) -> Tour:
    """A random tour; `force` is the largest one of a punch [N]."""
    radius = RADIUS * np.sqrt(rng.random(WAYPOINTS))
    bearing, heading = rng.uniform(0, 2 * np.pi, (2, WAYPOINTS))
    points = np.column_stack([AHEAD + radius * np.cos(bearing), radius * np.sin(bearing), heading])
    directions = rng.standard_normal((WAYPOINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    ceiling = force * (1 / 3 + 2 / 3 * np.minimum(POINT_SECONDS * np.arange(WAYPOINTS) / RISE_SECONDS, 1.0))
    sizes = ceiling * rng.uniform(0.5, 1.0, WAYPOINTS)
    return Tour(points, directions * sizes[:, None], rng.random(WAYPOINTS))


class WaypointLaw:
    """Velocity that leads to a waypoint, zero where it is reached.

    Args:
        robot: Its ranges of use bound the velocity.
    """

    def __init__(self, robot: WalkingRobot):
        self._space = robot.space
        self._is_there = False
        self._is_turned = False

    def __call__(self, offset: Array, turn: float) -> Array:
        """Wanted velocity; shape (3,).

        Args:
            offset: Waypoint from the robot, in its frame; shape (2,) [m].
            turn: Heading of the waypoint from that of the robot [rad].
        """
        self._is_there = bool(np.hypot(*offset) < REACHED[self._is_there])
        self._is_turned = bool(abs(turn) < TURNED[self._is_turned])
        wanted = GAIN * np.array([*(offset * (not self._is_there)), turn * (not self._is_turned)])
        return np.clip(wanted, self._space.state_lower, self._space.state_upper)


class Filtered:
    """The command of an exported filter, and what the wanted velocity has changed by since it was planned.

    Args:
        step_filter: The filter.
    """

    def __init__(self, step_filter: StepFilter):
        self._filter = step_filter
        self._space = step_filter.space
        self._state = np.zeros(3)
        self._wanted = np.zeros(3)
        self._planned = np.zeros(3)
        self._sent = list[Array]()

    def __call__(self, wanted: Array, velocity: Array, begins: bool) -> Array:
        """The command; see `Corrector`."""
        if begins:
            mean = np.mean(self._sent, axis=0) if self._sent else None
            if mean is not None:
                self._filter.update(self._state, mean, velocity)
            self._planned = self._filter.plan(velocity, wanted, mean).command
            self._state = velocity
            self._wanted = wanted
            self._sent.clear()
        command = self._planned + wanted - self._wanted
        self._sent.append(np.clip(command, self._space.command_lower, self._space.command_upper))
        return self._sent[-1]


def filter_of(robot: WalkingRobot, file: str) -> StepFilter:
    """The filter that StepGap exports after a walk and one redeployment of this individual."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        run = stepgap.run(file, out=out, gap=asdict(robot.gap), iterations=1, progress=False)
        controller = portable_controller(run, None, random_stream(0, 0, 3))
    return StepFilter(json.loads(model_text(controller)))


def walk_tour(robot: WalkingRobot, tour: Tour, correct: Corrector, rng: np.random.Generator) -> Walked:
    """Walks a tour.

    Args:
        robot: An individual.
        tour: The tour.
        correct: What stands between waypoint law and policy.
        rng: Draws the noise of measured velocities.
    """
    model = robot.gap.of(robot.mjcf_model())
    data = mujoco.MjData(model)
    robot.place(model, data, np.zeros(3))
    mujoco.mj_forward(model, data)
    control, law = robot.controller(), WaypointLaw(robot)
    late = deque([data.ctrl.copy()] * round(robot.gap.delay / robot.tick))
    noise = robot.gap.state_noise * robot.space.state_scale
    substeps = max(1, round(robot.tick / model.opt.timestep))
    ticks = round(PERIOD / robot.tick)
    start = np.array(robot.context(model, data))
    result = Walked(WAYPOINTS * POINT_SECONDS, [], [])
    sums, step, velocity, error = np.zeros(4), -1, np.zeros(3), np.zeros(3)
    for number in range(round(WAYPOINTS * POINT_SECONDS / PERIOD)):
        now = number * PERIOD
        point, since = divmod(now + 1e-9, POINT_SECONDS)
        if point and since < PERIOD:  # the end of a waypoint
            result.place.append(float(np.hypot(*error[:2])))
            result.heading.append(abs(float(error[2])))
        # a step of the filter begins every `walk.seconds`: the mean velocity of the one before is its state
        begins = int((now + 1e-9) // robot.walk.seconds) != step
        if begins:
            step += 1
            velocity = sums[:3] / max(sums[3], 1.0) + noise * rng.standard_normal(3)
            sums[:] = 0.0
        error = _error(tour.points[int(point)], start, np.array(robot.context(model, data)))
        command = correct(law(error[:2], error[2]), velocity, begins)
        # a punch acts on one body
        data.xfrc_applied[:] = 0.0
        if PUNCH_DELAY <= since < PUNCH_DELAY + PUNCH_SECONDS:
            body = 1 + int(tour.bodies[int(point)] * (model.nbody - 1))
            data.xfrc_applied[body, :3] = tour.forces[int(point)]
        for _ in range(ticks):
            control(model, data, command)
            late.append(data.ctrl.copy())
            data.ctrl[:] = late.popleft()
            mujoco.mj_step(model, data, substeps)
            sums += [*body_velocity(data), 1.0]
        if robot.failed(model, data) or not np.isfinite(data.qvel).all():
            return result._replace(seconds=now)
    result.place.append(float(np.hypot(*error[:2])))
    result.heading.append(abs(float(error[2])))
    return result


def _error(point: Array, start: Array, pose: Array) -> Array:
    """A waypoint, given from the start, in the frame of the robot; shape (3,)."""
    place = start[:2] + turned(start[2], *point[:2])
    turn = np.remainder(start[2] + point[2] - pose[2] + np.pi, 2 * np.pi) - np.pi
    return np.array([*turned(-pose[2], *(place - pose[:2])), turn])


def correctors(robot: WalkingRobot, cell: Cell) -> dict[str, Callable[[], Corrector]]:
    """What may stand between waypoint law and policy, by its name: a new one for each tour."""
    trip: Trip = walked(cell, 0, lambda target, state, before: target)
    inverse = affine_inverse(trip)
    space = robot.space
    learned = filter_of(robot, cell.robot)

    def affine(wanted: Array, velocity: Array, begins: bool) -> Array:
        return np.clip(inverse(wanted, velocity, wanted), space.command_lower, space.command_upper)

    def filtered() -> Corrector:
        learned.restart()
        return Filtered(learned)

    return {"nothing": lambda: lambda wanted, velocity, begins: wanted, "affine": lambda: affine, "StepGap": filtered}


def print_tables(rows: Sequence[Mapping[str, Any]]) -> None:
    """Prints a table in Markdown for each robot."""
    for robot in dict.fromkeys(row["robot"] for row in rows):
        here = [row for row in rows if row["robot"] == robot]
        print(f"\n{robot}: {len({row['gap'] for row in here})} individuals, {len(here)} tours")
        print("| between | survived [s] | completed | place [cm] | of nothing | heading [°] | of nothing |")
        print("|---|---|---|---|---|---|---|")
        for name in here[0]["tours"]:
            tours = [row["tours"][name] for row in here]
            seconds = np.mean([tour["seconds"] for tour in tours])
            completed = sum(len(tour["place"]) == WAYPOINTS for tour in tours)
            sizes, ratios = zip(*(_of_nothing(here, name, key) for key in ("place", "heading")), strict=True)
            print(
                f"| {name} | {seconds:.1f} | {completed} of {len(tours)} | {100 * sizes[0]:.0f} | {ratios[0]} | "
                f"{np.degrees(sizes[1]):.1f} | {ratios[1]} |"
            )


def _of_nothing(rows: Sequence[Mapping[str, Any]], name: str, key: str) -> tuple[float, str]:
    """Mean error of a corrector, and its ratio to that of nothing over individuals, with its interval."""
    gaps = dict.fromkeys(row["gap"] for row in rows)
    means = {
        corrector: [
            np.mean([value for row in rows if row["gap"] == gap for value in row["tours"][corrector][key]])
            for gap in gaps
        ]
        for corrector in (name, "nothing")
    }
    every = [value for row in rows for value in row["tours"][name][key]]
    return float(np.mean(every)), ratio(np.log(np.divide(means[name], means["nothing"])))


def main() -> None:
    """Walks the tours that `--out` lacks, and prints the tables of all."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--robots", default="velocity")
    parser.add_argument("--gaps", type=int, default=3)
    parser.add_argument("--first-gap", type=int, default=95001)
    parser.add_argument("--tours", type=int, default=3)
    parser.add_argument("--force", type=float, default=500.0)
    given = parser.parse_args()
    rows: list[dict[str, Any]] = [json.loads(line) for line in given.out.open()] if given.out.exists() else []
    done = {(row["robot"], row["gap"], row["tour"]) for row in rows}
    with given.out.open("a", encoding="utf-8") as out:
        for name in given.robots.split(","):
            for gap in range(given.first_gap, given.first_gap + given.gaps):
                waiting = [number for number in range(given.tours) if (name, gap, number) not in done]
                if not waiting:
                    continue
                cell = Cell(name, gap)
                robot = robot_of(cell)
                between = correctors(robot, cell)
                for number in waiting:
                    tour = tour_of(random_stream(number, 8), given.force)
                    tours = {
                        key: walk_tour(robot, tour, make(), random_stream(number, 9))._asdict()
                        for key, make in between.items()
                    }
                    rows.append({"robot": name, "gap": gap, "tour": number, "force": given.force, "tours": tours})
                    print(json.dumps(rows[-1]), file=out, flush=True)
    print_tables(rows)


if __name__ == "__main__":
    main()
