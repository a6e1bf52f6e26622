"""`stepgap explain` on hoppers with known differences from their model.

Each robot is a twin with sensors and torque noise of the default one, and one or two planted differences of random
size, from those in `USUAL`, which are also the possible causes. It steps to random targets, while it learns. The
resolution of its encoders is known. Robots of `outside` have a cause that is not in the list of possible causes, and
neither is any other that is like it; those of `none` have no cause.

Printed for each robot: what was planted, and the causes that explain most alone, with their sizes. Then how often a
planted cause explains most, or cannot be told from the one that does, how many of the causes that are said to act were
planted, how often a planted size lies in its 95 % interval, and how often something is said to be unexplained.

    ./go python -m benchmarks.explain [--robots 20] [--kinds one two outside none] [--steps 170]
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import finished, tracked
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.settings import Experiment
from stepgap.learning.learner import Learner
from stepgap.learning.observations import Observations, observe
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array, StepSpace
from stepgap.study.explanation import (
    REST_LOG_ODDS,
    Cause,
    Explanation,
    RunError,
    Shares,
    Simulate,
    Surface,
    alike_groups,
    causes_of,
    explain_error,
    find_signatures,
    most_probable,
)
from stepgap.study.simulated_errors import LEARNING, SimulatedRobots, gap_of, targets_of

USUAL = {
    "body_mass_scale": 1.05,
    "leg_mass_scale": 1.3,
    "leg_inertia_scale": 1.5,
    "boom_inertia_scale": 1.25,
    "boom_friction": 0.2,
    "boom_drag": 0.2,
    "boom_stiffness": 1.5e4,
    "ground_stiffness": 4e4,
    "joint_friction": 0.04,
    "joint_damping": 0.004,
    "rotor_inertia": 3e-4,
    "torque_scale": 0.94,
    "torque_imbalance": 0.02,
    "torque_lag": 1.5e-3,
    "delay": 1e-3,
    "motor_offset_1": 0.004,
    "motor_offset_2": 0.004,
}
"""Usual values of the causes that are planted."""

ENCODERS = ("motor_counts", "boom_counts_horizontal", "boom_counts_vertical")
NOISE = ("torque_noise", "torque_noise_time")
"""What all these robots have of the default twin; the resolution of the encoders is known."""


DRAWS = 10
"""How often the sizes of a robot that falls are drawn again."""


class Robot(NamedTuple):
    """A robot: one, two, outside, or none; and its number."""

    kind: str
    number: int


class Found(NamedTuple):
    """What was found: names of the planted causes with their values, the explanation, and the time [s]."""

    planted: dict[str, float]
    explanation: Explanation
    seconds: float


def planted(robot: Robot, causes: Mapping[str, Cause], draw: int) -> dict[str, float]:
    """Names and values of the causes of a robot."""
    if robot.kind == "none":
        return {}
    rng = random_stream(robot.number, {"one": 1, "two": 2, "outside": 1}[robot.kind], draw)
    names = [[*USUAL][robot.number % len(USUAL)]]
    if robot.kind == "two":
        names.append(str(rng.choice([name for name in USUAL if name not in names])))
    values = {}
    for name in names:
        share = rng.uniform(0.6, 1.5) * (rng.choice([-1, 1]) if causes[name].signed else 1)
        values[name] = causes[name]._replace(usual=USUAL[name]).value(share)
    return values


def random_targets(space: StepSpace, number: int, steps: int) -> Reference:
    """Targets within 0.9 of the ranges of use that change every one to three steps."""
    rng, rows = random_stream(number, 12), list[Array]()
    while len(rows) < steps:
        target = space.state_centre + 0.9 * space.state_scale * rng.uniform(-1, 1, len(space.state))
        rows += [target] * int(rng.integers(1, 4))
    return Reference(space.state_names, np.array(rows[:steps]))


def run_of(hopper: Hopper, number: int, steps: int) -> Observations:
    """Steps of a robot along the reference."""
    nominal = hopper.apex_map()
    simulation = next(iter(hopper.simulations().values()))(random_stream(number, 10))
    learner = Learner.start(nominal, Steps(nominal.space), LEARNING, 0)
    plant = simulation.plant(random_stream(number, 11))
    log = tracked(learner, plant, random_targets(nominal.space, number, steps), 0)
    return observe(log.completed(), nominal)


def usual(names: Sequence[str]) -> dict[str, float]:
    """Differences of the default twin."""
    return {name: getattr(RealityGap(), name) for name in names}


def hopper_with(values: Mapping[str, float]) -> Hopper:
    """A hopper with some differences, and sensors of the default one."""
    return Hopper(gap=replace(RealityGap.none(), **usual(ENCODERS + NOISE), **values))


def explained(steps: int, robot: Robot) -> Found:
    """What is found of a robot."""
    begin, settings = perf_counter(), Experiment(Hopper(gap=RealityGap()))
    possible = {each.name: each for each in causes_of(gap_of(settings))}
    with one_blas_thread():
        for draw in range(DRAWS):
            values = planted(robot, possible, draw)
            run = run_of(hopper_with(values), robot.number, steps)
            if 2 * len(run) > steps:
                break
        else:
            raise RuntimeError(f"{robot}: no draw hops")
        robots = SimulatedRobots(settings, targets_of(run), known=usual(ENCODERS))

        def simulate(asked: Sequence[tuple[Shares, int]]) -> list[Surface | None]:
            return [robots.surface(shares, number) for shares, number in asked]

        error, causes = RunError.of(run), [possible[name] for name in USUAL]
        if robot.kind == "outside":
            causes = without_group(error, simulate, causes, next(iter(values)))
        found = explain_error(error, causes, simulate)
    return Found(values, found, perf_counter() - begin)


def without_group(error: RunError, simulate: Simulate, causes: Sequence[Cause], name: str) -> list[Cause]:
    """The causes that are not like one."""
    none, signatures = find_signatures(error, causes, simulate)
    walked = [cause for cause in causes if cause.name in signatures]
    fit = most_probable(error, none, np.array([signatures[cause.name] for cause in walked]))
    own = next(group for group in alike_groups(fit.cosines, walked) if name in [cause.name for cause in group])
    return [cause for cause in causes if cause not in own]


def describe(robot: Robot, found: Found) -> None:
    """Prints a robot."""
    truth = ", ".join(f"{name} {value:.4g}" for name, value in found.planted.items())
    shown = [size for number, size in enumerate(found.explanation.causes) if number < 3 or size.acts]
    sizes = [
        f"{size.cause.name} {size.value:.4g} ({size.interval[0]:.4g}–{size.interval[1]:.4g})"
        f"{' acts' * size.acts}; alone {size.cause.value(size.alone):.4g}: {size.explained:.0%}"
        for size in shown
    ]
    rest = f"rest {found.explanation.rest:.0%} ({found.explanation.rest_log_odds:+.1f})"
    print(f"{robot.kind} {robot.number}: {truth} | {' | '.join(sizes)} | {rest} | {found.seconds:.0f} s", flush=True)


def judge(kind: str, results: Sequence[Found]) -> None:
    """Prints how often robots of a kind were explained rightly."""
    first = alike = inside = sizes = acting = right = 0
    for result in results:
        causes = result.explanation.causes
        best = causes[0].cause
        near = [group for group in result.explanation.alike if best in group]
        first += best.name in result.planted
        alike += any(cause.name in result.planted for group in [*near, (best,)] for cause in group)
        for size in causes:
            acting += size.acts
            if size.cause.name in result.planted:
                low, high = size.interval
                sizes += 1
                inside += low <= result.planted[size.cause.name] <= high
                right += size.acts
    more = sum(result.explanation.rest_log_odds > REST_LOG_ODDS for result in results)
    large = sum(result.explanation.has_rest for result in results)
    print(f"{kind}: a planted cause explains most in {first} of {len(results)}; with those that are like it in {alike}")
    print(
        f"  {inside} of {sizes} planted sizes in their intervals; {acting} causes said to act, {right} of them planted"
    )
    print(f"  more than noise is said to be unexplained in {more}, of which {large} are large")


def main() -> None:
    """Prints all robots."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--kinds", nargs="+", default=["one", "two", "outside", "none"])
    parser.add_argument("--steps", type=int, default=170)
    given = parser.parse_args()
    cases = [Robot(kind, number) for kind in given.kinds for number in range(given.robots)]
    results = dict[Robot, Found]()
    for case, result in finished(partial(explained, given.steps), cases):
        describe(case, result)
        results[case] = result
    for kind in given.kinds:
        judge(kind, [results[case] for case in cases if case.kind == kind])


if __name__ == "__main__":
    main()
