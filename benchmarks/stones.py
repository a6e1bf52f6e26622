"""Hops from stone to stone: how far footholds are from the middles of the stones.

The twin with footholds learns from 227 hops with random strides, then hops over stones at random distances, on ground
without gaps, so that a miss ends nothing: it is a foothold more than 40 mm beside the middle of its stone. `nominal`
knows nothing; `learned` knows these hops, and learns from hop to hop.

    ./go python -m benchmarks.stones [--spreads 0.1,0.2] [--seeds 1] [--hops 500]
"""

import argparse
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import finished, own_priors
from benchmarks.uneven_ground import hops_of
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.footholds import OVER_STONES, random_strides
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array

WAYS = ("nominal", "learned")

MEAN_DISTANCE = 0.25
"""Mean distance of the middles of two stones [m]."""

MISS = 0.04
"""Distance from the middle of a stone at which a foot misses it [m]."""

FIRST = 5
"""Number of first hops that are left out, in which the robot starts from rest."""


class Case(NamedTuple):
    """One run; distances of stones are 0.25 m ± the spread [m]."""

    spread: float
    way: str
    seed: int
    hops: int


class Found(NamedTuple):
    """Errors of its footholds [m], of the heights of its apexes [m], and whether the robot fell."""

    footholds: Array
    heights: Array
    fell: bool


def stones(case: Case) -> Reference:
    """Strides from stone to stone."""
    rng = random_stream(case.seed, 78)
    distances = MEAN_DISTANCE + case.spread * rng.uniform(-1, 1, case.hops + FIRST)
    return Reference(("height", "stride"), np.column_stack([np.full(len(distances), OVER_STONES), distances]))


def measured(case: Case) -> Found:
    """One run."""
    hopper = Hopper(ground=UnevenGround(footholds=True))
    nominal, known = hopper.apex_map(), Steps(hopper.space)
    simulation, none = hopper.simulations()["twin"](random_stream(case.seed, 9)), LearningSettings(residual="none")
    with one_blas_thread():
        if case.way != "nominal":
            plant = simulation.plant(random_stream(case.seed, 0))
            known, _ = hops_of(Learner.start(nominal, known, none, 0), plant, random_strides(), 0)
        settings = none if case.way == "nominal" else LearningSettings()
        plant = simulation.plant(random_stream(case.seed, 1, 8))
        learner = Learner.start(nominal, known, settings, 1, own_priors(hopper))
        log, _ = hops_of(learner, plant, stones(case), 1)
    hops = log.tracking()
    foothold, names = hops.context[:, hopper.space.context_names.index("foothold")], hopper.space.state_names
    late = np.diff(foothold) - hops.target[:-1, names.index("stride")]
    height = hops.next_state[:-1, 1] - hops.target[:-1, 1]
    return Found(late[FIRST:], height[FIRST:], hops.failed_steps > 0)


def main() -> None:
    """Prints a row for each spread and way."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spreads", default="0.1,0.2")
    parser.add_argument("--ways", default=",".join(WAYS))
    parser.add_argument("--seeds", default="1")
    parser.add_argument("--hops", type=int, default=500)
    options = parser.parse_args()
    spreads, ways = [float(each) for each in options.spreads.split(",")], options.ways.split(",")
    cases = [Case(s, w, int(n), options.hops) for s in spreads for w in ways for n in options.seeds.split(",")]
    found = dict(finished(measured, cases))
    print("stones [cm]  way       RMSE, largest [mm]  misses         height RMSE [mm]")
    for spread in spreads:
        for way in ways:
            runs = [each for case, each in found.items() if (case.spread, case.way) == (spread, way)]
            late, height = (np.concatenate(each) for each in list(zip(*runs, strict=True))[:2])
            ends = f"{100 * (MEAN_DISTANCE - spread):.0f} to {100 * (MEAN_DISTANCE + spread):.0f}"
            rmse, largest, off = 1e3 * np.sqrt(np.mean(late**2)), 1e3 * np.abs(late).max(), np.sqrt(np.mean(height**2))
            missed, falls = np.count_nonzero(np.abs(late) > MISS), sum(each.fell for each in runs)
            print(f"{ends:12} {way:8} {rmse:6.1f} {largest:8.0f}       {missed} of {len(late)}, {falls} falls ", end="")
            print(f"  {1e3 * off:.1f}")


if __name__ == "__main__":
    main()
