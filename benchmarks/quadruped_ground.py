"""The quadruped on uneven ground: errors above the ground under its feet, and falls.

It hops after random targets that change every 4 to 8 hops. `blind` and `touchdown` know 100 hops on flat ground; blind
is the same controller without a new plan when all feet have landed, which knows the ground of the hop before alone.
`again` has hopped on this ground before. All but `nominal` learn from hop to hop. On the grounds `floors` the whole
floor is at another height at each hop; on the others the ground is one by place. After a fall the robot starts at
another place. Errors are those of the true state above the ground that was measured. The feet are raised by 5 cm while
it rises, 2 cm more than by default.

    ./go python -m benchmarks.quadruped_ground [--grounds floors_30,stairs_31] [--seeds 1,2,3] [--hops 60]
"""

import argparse
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import finished, own_priors
from benchmarks.uneven_ground import Blind
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.mujoco_robots.mjcf.mjcf_robot import MjcfPlant
from stepgap.mujoco_robots.quadruped.pronk import PronkGains
from stepgap.mujoco_robots.quadruped.robot import Quadruped
from stepgap.plants.plant import Plant
from stepgap.robots.ground import UnevenGround
from stepgap.step import Array

FLAT = UnevenGround(measured_heights=True)

FLOORS: Mapping[str, float] = {f"floors_{mm}": mm / 1e3 for mm in (15, 30)}
"""Largest height of a floor that is another one at each hop [m]."""

GROUNDS: Mapping[str, UnevenGround] = {
    "flat": FLAT,
    **dict.fromkeys(FLOORS, FLAT),
    **{f"stairs_{mm}": UnevenGround(stair_height=mm / 1e3) for mm in (15, 31, 62)},
    "ramps_5": UnevenGround(slope=0.05),
    "ramps_10": UnevenGround(slope=0.1),
    "soft": UnevenGround(patch_stiffness=0.1),
    "slippery": UnevenGround(patch_friction=0.5),
}
"""Grounds by name."""

WAYS = ("nominal", "blind", "touchdown", "again")

GAINS = PronkGains(retraction=0.05)

LEARNED = 100
"""Hops from which is learned."""


class Case(NamedTuple):
    """One run."""

    ground: str
    way: str
    seed: int
    hops: int


class Found(NamedTuple):
    """Its hops.

    Attributes:
        errors: Errors of the true speed [m/s] and height [m]; shape (N, 2).
        at_bound: Whether one of its forces was at a bound; shape (N,).
        falls: Number of hops that failed.
    """

    errors: Array
    at_bound: Array
    falls: int


def random_reference(rng: np.random.Generator, hops: int) -> Reference:
    """Speeds and heights within the range of use, each for 4 to 8 hops."""
    rows = list[Array]()
    while len(rows) < hops:
        rows += [rng.uniform([0.35, 0.4], [0.65, 0.43])] * int(rng.integers(4, 9))
    return Reference(("speed", "height"), np.array(rows[:hops]))


def hops_of(learner: Learner, plant: Plant, reference: Reference, between: Callable[[], None]) -> Steps:
    """The hops of a deployment; something is done before each of them."""
    log = Steps(plant.space)
    with closing(deploy(learner, plant, reference, learner.iteration)) as steps:
        for logged in steps:
            log += [logged]
            between()
    return log


def deployments(case: Case, ground: str, way: str, learner: Learner, hops: int) -> list[Steps]:
    """So many hops on a ground; after a fall, of another deployment."""
    robot, logs = Quadruped(ground=GROUNDS[ground], gains=GAINS), list[Steps]()
    simulation, rng = robot.simulations()["mujoco"](random_stream(case.seed, 9)), random_stream(case.seed, 7)
    while (left := hops - sum(map(len, logs))) > 0:
        plant = simulation.plant(random_stream(case.seed, learner.iteration, len(logs)))
        assert isinstance(plant, MjcfPlant)

        def between(plant: MjcfPlant = plant) -> None:
            if ground in FLOORS:
                model = plant._stepper._model
                model.geom_sameframe[model.geom("floor").id] = 0  # else its place is that of the world
                model.geom("floor").pos[2] = rng.uniform(-FLOORS[ground], FLOORS[ground])

        chosen = Blind(plant) if way == "blind" else plant
        logs.append(hops_of(learner, chosen, random_reference(rng, left), between))
    return logs


def measured(case: Case) -> Found:
    """One run."""
    robot, none = Quadruped(ground=GROUNDS[case.ground]), LearningSettings(residual="none")
    nominal = robot.nominal_maps()["spring_mass"]()
    known = Steps(nominal.space)
    with one_blas_thread():
        if case.way != "nominal":
            before = case.ground if case.way == "again" else "flat"
            for log in deployments(case, before, "touchdown", Learner.start(nominal, known, none, 0), LEARNED):
                known += log
        settings = none if case.way == "nominal" else LearningSettings()
        learner = Learner.start(nominal, known, settings, 1, own_priors(robot))
        logs = deployments(case, case.ground, case.way, learner, case.hops)
    hops = [each for log in logs for each in log.planned().completed()]
    errors = np.array([each.record.true_next_state - each.target for each in hops]).reshape(-1, 2)
    points = nominal.space.point_of(np.array([each.record.requested for each in hops]).reshape(-1, 2))
    return Found(errors, np.abs(points).max(axis=1) >= 1, sum(log.failed_steps for log in logs))


def main() -> None:
    """Prints a row for each ground and way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grounds", default=",".join(GROUNDS))
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--hops", type=int, default=60)
    options = parser.parse_args()
    grounds, ways, seeds = options.grounds.split(","), options.ways.split(","), map(int, options.seeds.split(","))
    found = dict(finished(measured, [Case(g, w, s, options.hops) for s in seeds for g in grounds for w in ways]))
    print("RMSE [mm/s, mm], falls of hops; height: median error, 90 % quantile [mm]; hops with a force at its bound")
    for ground in grounds:
        for way in ways:
            runs = [each for case, each in found.items() if (case.ground, case.way) == (ground, way)]
            errors, falls = np.concatenate([each.errors for each in runs]), sum(each.falls for each in runs)
            speed, height = 1e3 * np.sqrt(np.mean(errors**2, axis=0))
            usual, most = 1e3 * np.quantile(np.abs(errors[:, 1]), [0.5, 0.9])
            bound = np.mean(np.concatenate([each.at_bound for each in runs]))
            hops = f"{falls} of {len(errors) + falls}"
            print(
                f"{ground:10} {way:10} {speed:6.1f} {height:6.1f}   {hops:10} {usual:5.1f} {most:5.1f}   {bound:4.0%}"
            )


if __name__ == "__main__":
    main()
