"""Priors over robots: the error of the first steps of unseen robots that learn online, with and without one.

The prior is found from random robots of a kind that step to random targets with the nominal map alone. Then others, and
hoppers that the family of twins does not draw, track the beginning of their reference. Wrong priors are those of the
same twins with inverted commands, with exchanged commands, and with errors in another unit.

Left out are hoppers that cannot track the reference however much they have learned: those whose last 20 hops without a
prior have, with one of the seeds, more than twice the final error of the paper's robot. Their numbers are printed.

Printed for each group and prior: falls, error of the first step (root mean square over the runs), of steps 1–10, 11–20
and 81–100 (median and 90 % quantile), each in thousandths of the units of the states, such as mm/s and mm; what the
controller itself expected of steps 1–10 and 11–20 (median of the root mean squares), which is the least error that its
knowledge permits; then, paired by run, the median ratio of the error [half ranges] of steps 1–20, 41–100 and 81–100 to
that without a prior, with a 95 % interval (bootstrap).

    ./go python -m benchmarks.priors [--robot hopper] [--family 80] [--twins 20] [--seeds 3] [--out prior.json]
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import finished, tracked, uncorrected
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.cautious_controller import CautiousController
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.experiment.exploration import exploration_plan, goals_of
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, observe
from stepgap.learning.prior import LEAST_FOR_PRIOR, Prior, fit_prior
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.records.prior_file import PriorFile
from stepgap.robots.entry_points import load_robot
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.robot import Robot
from stepgap.step import Array, StepMap, StepSpace

BAND = np.array([0.0179, 0.0052])
"""Final errors of the paper's robot: speed [m/s] and height [m]."""

STEPS, LAST = 100, 20
"""Hops of a run, and how many of them are the last."""

BOUND_STEPS = (0, 1, 2, 3, 5, 10, 20)
"""Numbers of steps after which it is printed what can be known."""

LEAST_STEPS = 15
"""Hops from which a twin of the family says something."""

FIRST_UNSEEN = 1000
"""Number of the first twin that no prior has seen."""

OUTSIDE: Mapping[str, Mapping[str, float]] = {
    "soft boom, heavy": {"boom_stiffness": 7e3, "body_mass_scale": 1.25},
    "weak, late": {"torque_scale": 0.6, "torque_lag": 4e-3},
    "rough slope": {"ground_roughness": 2e-3, "boom_tilt": 0.006},
    "strong, slope": {"torque_scale": 1.15, "boom_tilt": -0.005},
    "late, soft ground": {"torque_lag": 4e-3, "ground_stiffness": 1.2e4},
    "rubbing": {"joint_friction": 0.15, "joint_damping": 0.01},
}
"""Differences of robots that the family does not draw, from the default twin."""


class Run(NamedTuple):
    """One run: a kind of robot, which one, by its number or a name in `OUTSIDE`, a seed, and the name of a prior."""

    kind: str
    robot: int | str
    seed: int
    prior: str


def robot_of(kind: str, robot: int | str) -> Robot:
    """The robot of a run."""
    if isinstance(robot, str):
        return replace(Hopper(), gap=replace(Hopper().gap, **OUTSIDE[robot]))
    found = load_robot(kind).randomised(random_stream(robot))
    if found is None:
        raise ValueError(f"{kind}: no random robots")
    return found


def random_targets(space: StepSpace, number: int) -> Reference:
    """Targets within 0.9 of the ranges of use that change every one to three steps."""
    rng, rows = random_stream(number, 7), list[Array]()
    while len(rows) < 80:
        target = space.state_centre + 0.9 * space.state_scale * rng.uniform(-1, 1, len(space.state))
        rows += [np.where(space.tracked, target, np.nan)] * int(rng.integers(1, 4))
    return Reference(space.state_names, np.array(rows))


def plant_of(robot: Robot, world: np.random.Generator, rng: np.random.Generator) -> Plant:
    """The first simulated plant of a robot."""
    return next(iter(robot.simulations().values()))(world).plant(rng)


def nominal_of(robot: Robot) -> StepMap:
    """The first nominal map of a robot."""
    return next(iter(robot.nominal_maps().values()))()


def family_member(kind: str, number: int) -> Observations:
    """What a robot of the family does with the nominal map alone."""
    robot = robot_of(kind, number)
    with one_blas_thread():
        nominal, plant = nominal_of(robot), plant_of(robot, random_stream(number, 2), random_stream(number, 5))
        steps = tracked(uncorrected(nominal), plant, random_targets(robot.space, number), 0)
        return observe(steps.planned(), nominal)


def priors_of(robots: Sequence[Observations]) -> dict[str, Prior | None]:
    """The prior of these robots, wrong ones, and none."""

    def changed(each: Observations, kind: str) -> Observations:
        space = each.space
        if kind == "inverted":
            return replace(each, command=2 * space.command_centre - each.command)
        if kind == "swapped":
            return replace(each, command=space.command_at(np.roll(space.point_of(each.command), 1, axis=1)))
        return replace(each, error=each.error * np.append(3.6, np.ones(len(space.state) - 1)))

    wrong = {kind: fit_prior([changed(each, kind) for each in robots]) for kind in ("inverted", "swapped", "km/h")}
    return {"none": None, "prior": fit_prior(robots), **wrong}


def errors_of(priors: Mapping[str, Prior | None], run: Run) -> Array:
    """Tracking errors of a run and their expected size; shape (2, N, 2), with N less than `STEPS` if it fell."""
    robot = robot_of(run.kind, run.robot)
    number = run.robot if isinstance(run.robot, int) else sum(map(ord, run.robot))
    with one_blas_thread():
        nominal = nominal_of(robot)
        plant = plant_of(robot, random_stream(number, run.seed), random_stream(number, run.seed, 1))
        reference = next(iter(robot.references().values()))()
        rows = np.resize(reference.targets, (STEPS, len(reference.names)))
        learning = LearningSettings(online=True)
        learner = Learner.start(
            nominal, Steps(nominal.space), learning, 0, priors=[each] if (each := priors[run.prior]) else []
        )
        steps = tracked(learner, plant, Reference(reference.names, rows), 0)
        made = steps.planned().completed()
        return np.stack([made.tracking_errors(), made.std])


def print_bound(kind: str, priors: Mapping[str, Prior | None]) -> None:
    """Prints what can be known after a number of steps."""
    robot = load_robot(kind)
    nominal, reference = nominal_of(robot), next(iter(robot.references().values()))().of(robot.space)
    for name in ("none", "prior"):
        known = [each for each in (priors[name],) if each]
        learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(online=True), 0, known)
        start = learner.conditioned_residual
        goals = goals_of(reference, CorrectedMap(nominal, start))
        for way in ("best", "reference"):
            residual, state, cells = start, nominal.space.state_centre, list[str]()
            for count in range(max(BOUND_STEPS) + 1):
                if count in BOUND_STEPS:
                    variance = goals.weights @ residual.std(goals.points) ** 2 / goals.weights.sum()
                    noise = start.noise_std / residual.noise_std  # predicted values make it seem smaller
                    cells.append(f"{count}: {_pair(np.sqrt(variance) * noise)}")
                if way == "best":
                    step_map = CorrectedMap(nominal, residual)
                    controller = CautiousController(step_map, nominal, np.empty((0, goals.points.shape[1])))
                    plan = exploration_plan(controller, residual, state, goals)
                    point, state = np.append(state, plan.command), plan.predicted
                else:
                    before, target = reference.targets[max(count - 1, 0)], reference.targets[count]
                    command = StepController(CorrectedMap(nominal, start))(before, target).command
                    point = np.append(before, command)
                residual = residual.append(point, residual.mean(point))
            print(f"can be known: {name:6}{way:10} noise {_pair(start.noise_std)} | {' | '.join(cells)}", flush=True)


def part(errors: Array, first: int, last: int) -> Array:
    """Root-mean-square error of steps `first` to `last`, NaN if the robot did not make them; shape (n,)."""
    chosen = errors[first - 1 : last]
    return np.sqrt(np.mean(chosen**2, axis=0)) if len(chosen) == last - first + 1 else np.full(errors.shape[1], np.nan)


def print_group(name: str, runs: Sequence[Run], found: Mapping[Run, Array]) -> None:
    """Prints the rows of a group of runs."""
    errors = {run: both[0] for run, both in found.items()}
    for prior in dict.fromkeys(run.prior for run in runs):
        chosen = [run for run in runs if run.prior == prior]
        falls = sum(len(errors[run]) < STEPS for run in chosen)
        first = np.sqrt(np.nanmean([part(errors[run], 1, 1) ** 2 for run in chosen], axis=0))
        cells = [f"{name:9}{prior:9} falls {falls:2d} of {len(chosen)}", f"first {_pair(first)}"]
        for begin, end in ((1, 10), (11, 20), (STEPS - LAST + 1, STEPS)):
            values = np.array([part(errors[run], begin, end) for run in chosen])
            middle, most = np.nanquantile(values, [0.5, 0.9], axis=0)
            cells.append(f"{begin}–{end} {_pair(middle)} ({_pair(most)})")
        expected = [
            np.nanmedian([part(found[run][1], *span) for run in chosen], axis=0) for span in ((1, 10), (11, 20))
        ]
        cells.append(f"expected {'; '.join(map(_pair, expected))}")
        if prior != "none":
            cells += [_ratio(chosen, errors, *span) for span in ((1, 20), (41, 100), (STEPS - LAST + 1, STEPS))]
        print(" | ".join(cells), flush=True)


def unable(runs: Sequence[Run], found: Mapping[Run, Array]) -> set[int | str]:
    """Robots that do not track the reference after 80 hops of learning without a prior."""
    late = {run: part(found[run][0], STEPS - LAST + 1, STEPS) for run in runs if run.prior == "none"}
    return {run.robot for run, error in late.items() if run.kind == Hopper.name and not (error <= 2 * BAND).all()}


def _pair(error: Array) -> str:
    return ", ".join(f"{1e3 * each:.1f}" for each in error)


def _ratio(runs: Sequence[Run], errors: Mapping[Run, Array], first: int, last: int) -> str:
    """Median paired ratio of the error to that without a prior, with its interval."""

    def size(run: Run) -> float:
        return float(np.linalg.norm(part(errors[run], first, last) / load_robot(run.kind).space.state_scale))

    logs = np.log([size(run) / size(run._replace(prior="none")) for run in runs])
    logs = logs[np.isfinite(logs)]
    rng = np.random.default_rng(0)
    drawn = np.median(rng.choice(logs, (2000, len(logs))), axis=1)
    low, high = np.exp(np.quantile(drawn, [0.025, 0.975]))
    return f"ratio {first}–{last} {np.exp(np.median(logs)):.2f} ({low:.2f}–{high:.2f})"


def main() -> None:
    """Prints all groups."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default=Hopper.name)
    parser.add_argument("--family", type=int, default=80)
    parser.add_argument("--twins", type=int, default=20)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    members = dict(finished(partial(family_member, given.robot), range(given.family)))
    robots = [members[number] for number in sorted(members) if len(members[number]) >= LEAST_STEPS]
    print(f"{len(robots)} of {given.family} twins with {LEAST_STEPS} hops or more; a prior needs {LEAST_FOR_PRIOR}")
    priors, seeds = priors_of(robots), range(given.seeds)
    if given.out and (found := priors["prior"]):
        about = {"robots": len(robots), "steps": sum(map(len, robots)), "by": "benchmarks/priors.py"}
        nominal = next(iter(load_robot(given.robot).nominal_maps()))
        given.out.write_text(PriorFile(found, given.robot, nominal, about).text(), encoding="utf-8")
    twins = range(FIRST_UNSEEN, FIRST_UNSEEN + given.twins)
    right = ("none", "prior")
    groups = {
        "unseen": [Run(given.robot, *case) for case in product(twins, seeds, right)],
        "wrong": [Run(given.robot, *case) for case in product(twins, [0], [*priors][2:])],
    }
    if given.robot == Hopper.name:
        groups["outside"] = [Run(given.robot, *case) for case in product(OUTSIDE, seeds, right)]
    found = dict(finished(partial(errors_of, priors), [run for runs in groups.values() for run in runs]))
    left_out = unable([*found], found)
    print(f"left out: {', '.join(map(str, sorted(left_out, key=str))) or 'none'}")
    print_bound(given.robot, priors)
    for name, runs in groups.items():
        print_group(name, [run for run in runs if run.robot not in left_out], found)


if __name__ == "__main__":
    main()
