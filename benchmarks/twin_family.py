"""Survey of the family of random twins on which learning is benchmarked.

The family is that of `stepgap.robots.hopper.twin.family`. If the uncorrected robot falls within the first 20 steps, the
twin may be drawn again, as in `stepgap bench learning`. This script measures the fractions of these twins and of those
that fall later in the first deployment: 1 and 0 of 24 with seed 0.

    ./go python benchmarks/twin_family.py --draws 24
"""

import argparse

import numpy as np
from fit_paper_gap import first_deployment

from stepgap.rigs.rig import RigFault
from stepgap.robots.hopper.twin.family import random_gap
from stepgap.robots.hopper.twin.reality_gap import RealityGap

FIRST_STEPS = 20
"""Number of steps that the uncorrected robot must make without a fall; otherwise the twin may be drawn again."""


def hops(gap: RealityGap) -> bool:
    """Whether the uncorrected robot makes the first steps without a fall."""
    try:
        return first_deployment(gap, seed=0, most_steps=FIRST_STEPS)[1].falls == 0
    except RigFault:  # the hop before the first step failed
        return False


def main() -> None:
    """Prints a line per draw, and the numbers of falls."""
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
