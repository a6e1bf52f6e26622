"""Hops on uneven ground: how well they track heights above the ground, and what each part of the method adds.

The twin hops after random targets that change every 4 to 8 hops, each run 60 hops on another ground and place. `blind`
and `touchdown` know 227 hops on flat ground; blind is the same controller without a new plan at touchdown, which knows
the ground of the hop before alone. `again` has hopped 227 hops on that ground before. All but `nominal` learn from hop
to hop; `online` knows nothing before the first one. Errors are those of the true state above the ground that was
measured. `bumps` are random heights of 3 mm (standard deviation) every 5 cm, and `teeth` 0 and 3 mm in turn every
2.5 cm, as a scanned profile has them; another ground for each seed.

    ./go python -m benchmarks.uneven_ground [--grounds stairs_56,ramps_10] [--ways touchdown] [--seeds 1,2,3,4,5]
        [--hops 60]
    ./go python -W ignore -m benchmarks.uneven_ground --grounds bumps,teeth --ways nominal,online --hops 61
"""

import argparse
from collections.abc import Iterator, Mapping
from contextlib import closing
from math import tau
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import finished, own_priors
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import AdaptiveMap, deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.plant import Plant
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.paper import paper_reference, paper_result
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array, StepRecord, StepSpace

GROUNDS: Mapping[str, UnevenGround] = {
    "flat": UnevenGround(measured_heights=True),
    "stairs_56": UnevenGround(stair_height=0.056),
    "stairs_100": UnevenGround(stair_height=0.1),
    **{f"hops_{mm}": UnevenGround(stair_height=mm / 1e3, stair_length=0.06) for mm in (5, 15, 30, 50)},
    "ramps_5": UnevenGround(slope=0.05),
    "ramps_10": UnevenGround(slope=0.1),
    "soft": UnevenGround(patch_stiffness=0.1),
    "slippery": UnevenGround(patch_friction=0.5),
}
"""Grounds by name."""

BUMPS = {"bumps": 0.05, "teeth": 0.025}
"""Grounds with a scanned profile, and the distance of its rows [m]."""

WAYS = ("nominal", "blind", "touchdown", "again")  # and online


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
        grounds: Height of the ground of each hop [m]; shape (N,).
        falls: Number of hops that failed.
        alarms: Number of alarms.
    """

    errors: Array
    grounds: Array
    falls: int
    alarms: int


class Blind(Plant):
    """A plant that calls nobody at touchdown."""

    def __init__(self, plant: Plant):
        self._plant = plant

    @property
    def space(self) -> StepSpace:
        """That of the plant."""
        return self._plant.space

    @property
    def first_step(self) -> StepRecord | None:
        """That of the plant."""
        return self._plant.first_step

    def start(self) -> Array:
        """Starts the plant."""
        return self._plant.start()

    def take_step(self, command: Array) -> StepRecord:
        """A step of the plant, also where it might be planned again."""
        return self._plant.take_step(command)

    def stop(self) -> None:
        """Stops the plant."""
        self._plant.stop()


def random_reference(seed: int, hops: int) -> Reference:
    """Speeds and heights of the paper's range, each for 4 to 8 hops."""
    rng, rows = random_stream(seed, 77), list[Array]()
    while len(rows) < hops:
        rows += [rng.uniform([0.08, 0.55], [0.35, 0.62])] * int(rng.integers(4, 9))
    return Reference(("speed", "height"), np.array(rows[:hops]))


def hops_of(learner: Learner, plant: Plant, reference: Reference, iteration: int) -> tuple[Steps, AdaptiveMap]:
    """The hops of a deployment, and what was known after it."""
    log, latest = Steps(learner.nominal.space), list[AdaptiveMap]([learner])
    steps = deploy(learner, plant, reference.of(plant.space), iteration, on_learner=latest.append)
    with closing(steps):
        for logged in steps:
            log += [logged]
    return log, latest[-1]


def scan(case: Case, file: Path) -> UnevenGround:
    """The ground of a case of `BUMPS`, with its profile in a file."""
    place = np.arange(0, tau * Hopper().parameters.boom_length - 0.02, BUMPS[case.ground])
    heights = np.where(np.arange(len(place)) % 2, 0.003, 0.0)
    if case.ground == "bumps":
        heights = np.clip(np.random.default_rng(case.seed).normal(0, 0.003, len(place)), -0.009, 0.009)
    np.savetxt(file, np.column_stack([place, heights]), delimiter=",", header="place,height", comments="", fmt="%.6f")
    return UnevenGround(profile=str(file))


def measured(case: Case) -> Found:
    """One run."""
    if case.ground not in BUMPS:
        return measured_on(case, GROUNDS[case.ground])
    with TemporaryDirectory() as folder:
        return measured_on(case, scan(case, Path(folder) / "profile.csv"))


def measured_on(case: Case, floor: UnevenGround) -> Found:
    """One run on a floor."""
    uneven, flat = Hopper(ground=floor), Hopper(ground=GROUNDS["flat"])
    nominal, known = uneven.apex_map(), Steps(uneven.space)
    none = LearningSettings(residual="none")
    with one_blas_thread():
        if case.way not in ("nominal", "online"):
            before = uneven if case.way == "again" else flat
            plant = before.simulations()["twin"](random_stream(case.seed, 9)).plant(random_stream(case.seed, 0))
            known, _ = hops_of(Learner.start(nominal, known, none, 0), plant, paper_reference(), 0)
        settings = none if case.way == "nominal" else LearningSettings()
        plant = uneven.simulations()["twin"](random_stream(case.seed, 9)).plant(random_stream(case.seed, 1, 8))
        plant = Blind(plant) if case.way == "blind" else plant
        learner = Learner.start(nominal, known, settings, 1, own_priors(uneven))
        log, latest = hops_of(learner, plant, random_reference(case.seed, case.hops), 1)
    hops = log.planned().completed()
    true = np.array([each.record.true_next_state - each.target for each in hops]).reshape(-1, 2)
    ground = np.array([each.record.context["ground"] for each in hops])
    return Found(true, ground, log.failed_steps, len(latest.alarms))


def after_edges(found: Found) -> Iterator[Array]:
    """Error of each hop after one whose ground rose or fell by more than 20 mm."""
    edges = np.flatnonzero(np.abs(np.diff(found.grounds)) > 0.02) + 1
    yield from found.errors[edges[edges + 1 < len(found.errors)] + 1]


def main() -> None:
    """Prints a row for each ground and way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--grounds", default=",".join(GROUNDS))
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--seeds", default="1,2,3,4,5")
    parser.add_argument("--hops", type=int, default=60)
    options = parser.parse_args()
    grounds, ways, seeds = options.grounds.split(","), options.ways.split(","), map(int, options.seeds.split(","))
    cases = [Case(g, w, s, options.hops) for s in seeds for g in grounds for w in ways]
    found = dict(finished(measured, cases))
    band = 2 * np.array(paper_result().band)
    print("RMSE [mm/s, mm], falls of hops, alarms; hops after an edge within twice the band of the paper's robot")
    for ground in grounds:
        for way in ways:
            runs = [each for case, each in found.items() if (case.ground, case.way) == (ground, way)]
            errors = np.concatenate([each.errors for each in runs])
            edges = np.array([error for each in runs for error in after_edges(each)]).reshape(-1, 2)
            within = f"{(np.abs(edges) < band).all(axis=1).mean():.0%} of {len(edges)}" if len(edges) else ""
            speed, height = 1e3 * np.sqrt(np.mean(errors**2, axis=0))
            falls, alarms = sum(each.falls for each in runs), sum(each.alarms for each in runs)
            print(f"{ground:11} {way:10} {speed:6.1f} {height:6.1f}   {falls} of {len(errors)}, {alarms:3}   {within}")


if __name__ == "__main__":
    main()
