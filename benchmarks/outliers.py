"""Learning from hop to hop while the robot is pushed: the tracking error with and without `learning.reject_outliers`.

The twin hops through the paper's reference and learns online from its first hop. After some hops, drawn at random, it
is pushed at the apex: its speed changes by 0.2 to 0.5 m/s, forward or backward. The errors are those of the hops
without a push. Both ways have the same twin, the same noise and the same pushes.

    ./go python benchmarks/outliers.py --seeds 11,12,13 --rates 0,0.01,0.02,0.05
"""

import argparse
from contextlib import closing
from math import inf
from typing import NamedTuple

import numpy as np
from scipy.stats import t
from threadpoolctl import threadpool_limits

from stepgap.base.random_streams import random_stream
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import TwinPlant

PUSHES = (0.2, 0.5)
"""Least and largest change of the speed [m/s]."""


class Outcome(NamedTuple):
    """Result of one deployment.

    Attributes:
        rmse: Of speed and height at the hops without a push [half ranges]; infinite if the robot fell.
        pushes: Number of pushes.
        found: Number of pushed hops that were called outliers.
        wrong: Number of other hops that were called outliers.
        hops: Number of other hops.
    """

    rmse: float
    pushes: int
    found: int
    wrong: int
    hops: int


def deployment(seed: int, rate: float, reject: bool) -> Outcome:
    """Hops through the reference once, learning from the first hop on."""
    hopper = Hopper()
    simulation, nominal = hopper.simulations()["twin"](random_stream(seed)), hopper.nominal_maps()["equations"]()
    _, twin = simulation.direct_rig(random_stream(seed, 0))
    plant, rng = TwinPlant(twin, hopper.control()), random_stream(seed, 1)
    log, pushed = Steps(nominal.space), set[int]()
    settings = LearningSettings(online=True, reject_outliers=reject)
    learner = Learner.start(nominal, log, settings, 0)
    with closing(deploy(learner, plant, paper_reference(), 0)) as steps:
        for logged in steps:
            log += [logged]
            speed = rng.uniform(*PUSHES) * rng.choice([-1, 1])
            if rng.random() < rate:
                twin.push(speed)
                pushed.add(logged.step + 1)
    for logged in log:
        learner = learner.after(logged)
    outliers = {step for _, step in learner.outliers}
    others = [logged for logged in log.planned().completed() if logged.step not in pushed]
    error = np.array([logged.record.next_state - logged.target for logged in others]) / nominal.space.state_scale
    rmse = inf if log.failed_steps else float(np.sqrt(np.mean(error**2)))
    return Outcome(rmse, len(pushed), len(outliers & pushed), len(outliers - pushed), len(others))


def main() -> None:
    """Prints a row for each rate of pushes."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="11,12,13")
    parser.add_argument("--rates", default="0,0.01,0.02,0.05")
    options = parser.parse_args()
    seeds = [int(seed) for seed in options.seeds.split(",")]
    print("pushes  found  others called outliers  RMSE with / without (95 %)  falls with, without", flush=True)
    with threadpool_limits(limits=1, user_api="blas"):
        for rate in map(float, options.rates.split(",")):
            ways = [[deployment(seed, rate, reject) for seed in seeds] for reject in (True, False)]
            given, missing = ([outcome.rmse for outcome in outcomes] for outcomes in ways)
            ratios = np.log(np.array(given) / np.array(missing))
            half = t.ppf(0.975, len(seeds) - 1) * ratios.std(ddof=1) / np.sqrt(len(seeds))
            mean, low, high = np.exp([ratios.mean(), ratios.mean() - half, ratios.mean() + half])
            pushes, found, wrong, hops = (sum(values) for values in list(zip(*ways[0], strict=True))[1:])
            falls = ", ".join(str(sum(np.isinf(errors))) for errors in (given, missing))
            print(
                f"{100 * rate:4.0f} %  {found} of {pushes}  {100 * wrong / hops:.2f} %  "
                f"{mean:.3f} ({low:.3f}–{high:.3f})  {falls}",
                flush=True,
            )


if __name__ == "__main__":
    main()
