"""Coverage of the 95 % prediction intervals of single deployments, with and without their calibration.

Each twin hops through the paper's reference without correction, learns from that, and then follows random targets: one
of five speeds and any height, each for 1 to 8 hops, while it goes on learning. So at first most hops resemble none of
the deployment before. A row is a deployment; a bin has the hops of one target speed. Twin −1 is the default one, the
others are random.

    ./go python -m benchmarks.interval_coverage --twins=-1,0,1,2,3,4,5,6,7,8,9
"""

import argparse
from dataclasses import replace

import numpy as np

from benchmarks.disturbed_plant import own_priors
from benchmarks.learning.tasks import DEFAULT_TASK, Task, tasks
from benchmarks.learning.trial import Trial, hopping_gap
from stepgap.base.blas import one_blas_thread
from stepgap.base.normal import INTERVAL_95
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.step import Array

SPEEDS = (0.0, 0.1, 0.2, 0.3, 0.4)
"""Target speeds [m/s]."""

HEIGHTS = (0.55, 0.63)
"""Least and largest target height [m]."""

LONGEST = 8
"""Largest number of hops with one target."""

FEWEST = 200
"""A bin of a deployment counts if it has this number of hops."""

INTENDED = (0.90, 0.98)
"""Coverage that a bin should have."""


def random_reference(rng: np.random.Generator, steps: int) -> Reference:
    """Random targets, each for some hops."""
    rows: list[tuple[float, float]] = []
    while len(rows) < steps:
        rows += [(rng.choice(SPEEDS), rng.uniform(*HEIGHTS))] * int(rng.integers(1, LONGEST + 1))
    return Reference(("speed", "height"), np.array(rows[:steps]))


def deployments(twin: int, seed: int, steps: int) -> tuple[Steps, Learner]:
    """Steps of the second deployment of a twin, and the learner before it."""
    nominal, task, key = ApexMap(), tasks()[DEFAULT_TASK], 1000 if twin < 0 else twin
    gap = RealityGap() if twin < 0 else hopping_gap(nominal, task, twin)[0]
    trial = Trial(nominal, gap, task, key, seed, priors=own_priors(Hopper()))
    learner = trial.learner(nominal, trial.first, LearningSettings(), 1)
    reference = random_reference(random_stream(key, seed, 2), steps)
    return replace(trial, task=Task("random", reference)).deploy(learner, 1), learner


def without_calibration(steps: Steps, learner: Learner) -> Array:
    """Standard deviations that the corrected maps of a deployment state; shape (N, n)."""
    stds: list[Array] = []
    for logged in steps:
        step_map, record = learner.step_map(), logged.record
        stds.append(np.hypot(step_map.std(record.state, record.command), step_map.noise_std))
        learner = learner.after(logged)
    return np.array(stds)


def covered(steps: Steps, std: Array) -> Array:
    """Which next states are in their interval; shape (N, n), NaN without an interval."""
    inside = np.abs(steps.next_state - steps.predicted) <= INTERVAL_95 * std
    counted = (std > 0) & np.isfinite(steps.next_state) & ~steps.unplanned[:, None]
    return np.where(counted, inside, np.nan)


def main() -> None:
    """Prints a row for each deployment, coordinate, and kind of interval, and the means over all deployments."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", default="-1,0,1,2,3,4,5,6,7,8,9")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--hops", type=int, default=1250)
    options = parser.parse_args()
    shares: dict[tuple[str, str], list[Array]] = {}
    counted: dict[tuple[str, str], list[float]] = {}
    print("covered [%]" + " " * 25 + "".join(f"{speed:7.1f} m/s" for speed in SPEEDS) + "        all", flush=True)
    for twin in map(int, options.twins.split(",")):
        with one_blas_thread():
            steps, learner = deployments(twin, options.seed, options.hops)
            kinds = {"stated": without_calibration(steps, learner), "calibrated": steps.std}
        bins = [steps.target[:, 0] == speed for speed in SPEEDS]
        for row, name in enumerate(steps.space.state_names):
            for kind, std in kinds.items():
                inside = covered(steps, std)[:, row]
                share = np.array([*(float(np.nanmean(inside[part])) for part in bins), float(np.nanmean(inside))])
                shares.setdefault((name, kind), []).append(share)
                full = [found for found, part in zip(share, bins, strict=False) if part.sum() >= FEWEST]
                counted.setdefault((name, kind), []).extend(full)
                label = f"twin {twin}, {name}, {kind}"
                print(f"{label:36}" + "".join(f"{100 * each:11.1f}" for each in share), flush=True)
    for (name, kind), rows in shares.items():
        label = f"mean, {name}, {kind}"
        print(f"{label:36}" + "".join(f"{100 * each:11.1f}" for each in np.mean(rows, axis=0)))
        found = np.array(counted[name, kind])
        low, high = int((found < INTENDED[0]).sum()), int((found > INTENDED[1]).sum())
        print(f"{'':8}of {len(found)} bins with {FEWEST} hops {low} below 90 %, {high} above 98 %")


if __name__ == "__main__":
    main()
