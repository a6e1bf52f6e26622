"""A family of random twins, to benchmark learning on more than one robot.

The family is that of `stepgap.robots.hopper.twin.family`. A draw whose uncorrected robot does not get through the
first 20 steps may be drawn again, as `stepgap bench learning` does; the share of these, and of those that fall later in
the first deployment, is what this script measures: 1 and 0 of 24 with seed 0.

    ./go python benchmarks/twin_family.py --draws 24
"""

import argparse

import numpy as np
from fit_paper_gap import first_deployment

from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.twin.family import random_gap
from stepgap.robots.hopper.twin.reality_gap import RealityGap

FIRST_STEPS = 20
"""Steps that the uncorrected robot of a draw must manage, or else it may be drawn again."""


def hops(gap: RealityGap) -> bool:
    """Whether the uncorrected robot manages the first steps."""
    try:
        return first_deployment(gap, seed=0, most_steps=FIRST_STEPS)[1].falls == 0
    except RigFault:  # not even the hop before them
        return False


def main() -> None:
    """Prints a line per draw, and the shares that fall."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=24)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, early, late = np.random.default_rng(options.seed), 0, 0
    print("draw  steps  speed: RMSE, bias [m/s]  height: RMSE, bias [m]")
    for draw in range(options.draws):
        gap = random_gap(rng)
        if not hops(gap):
            early += 1
            print(f"{draw:4}  falls within {FIRST_STEPS} steps", flush=True)
            continue
        deployment = first_deployment(gap, seed=0)[1]
        late += deployment.falls
        (speed, height), (ahead, above) = deployment.rmse, deployment.bias
        print(f"{draw:4}  {deployment.steps:5}  {speed:.4f} {ahead:+.4f}  {height:.4f} {above:+.4f}", flush=True)
    print(f"of {options.draws} draws {early} fell within {FIRST_STEPS} steps and {late} later")


if __name__ == "__main__":
    main()
