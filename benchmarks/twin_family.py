"""A family of random twins, to benchmark learning on more than one robot.

Every difference of the preset `RealityGap()` is drawn anew and on its own, between no gap and 1.5 times the preset's
difference; those of either sign get a random one. No draw is judged by how well learning works on it. A draw whose
uncorrected robot does not get through the first 20 steps may be drawn again (`hopping_gap`); the share of these, and of
those that fall later in the first deployment, is what this script measures: 1 and 0 of 24 with seed 0.

    ./go python benchmarks/twin_family.py --draws 24
"""

import argparse
from dataclasses import replace
from math import isinf
from typing import NamedTuple

import numpy as np
from fit_paper_gap import first_deployment

from stepgap.rigs.rig import RigFault
from stepgap.rigs.twin.reality_gap import RealityGap

FIRST_STEPS = 20
"""Steps that the uncorrected robot of a draw must manage, or else it may be drawn again."""


class Shares(NamedTuple):
    """Range of a difference in parts of the preset's; 0 is no gap."""

    lowest: float = 0.0
    highest: float = 1.5
    signed: bool = False


EITHER_SIGN = Shares(signed=True)
DRAWN = {
    "body_mass_scale": EITHER_SIGN,
    "leg_mass_scale": EITHER_SIGN,
    "leg_inertia_scale": EITHER_SIGN,
    "body_com_offset": EITHER_SIGN,
    "boom_inertia_scale": Shares(),
    "boom_stiffness": Shares(),
    "boom_friction": Shares(),
    "boom_drag": Shares(),
    "boom_tilt": EITHER_SIGN,
    "ground_stiffness": Shares(),
    "ground_friction": Shares(lowest=0.4, highest=1.2),  # on the arc a foot that never slips would lock the boom
    "ground_roughness": Shares(),
    "ground_slope": EITHER_SIGN,
    "joint_friction": Shares(),
    "joint_damping": Shares(),
    "rotor_inertia": Shares(),
    "torque_scale": Shares(),
    "torque_imbalance": EITHER_SIGN,
    "torque_saturation": Shares(),
    "torque_noise": Shares(),
    "torque_lag": Shares(),
    "delay": Shares(),
    "motor_offset_1": EITHER_SIGN,
    "motor_offset_2": EITHER_SIGN,
}
"""What is drawn; the rest (sensors, thresholds, the arc, damping ratios) is the preset's."""

BESIDE_PRESET = {"boom_drag": 0.2, "torque_imbalance": 0.01, "ground_slope": 3e-4}
"""Differences that the preset does not have, and what stands for the preset's value."""


def random_gap(rng: np.random.Generator) -> RealityGap:
    """A twin of the family: no gap + share × (preset − no gap), or preset / share where no gap is infinite."""
    none, preset = RealityGap.none(), replace(RealityGap(), **BESIDE_PRESET)
    values = {}
    for name, shares in DRAWN.items():
        share = rng.uniform(shares.lowest, shares.highest)
        if shares.signed and rng.random() < 0.5:
            share = -share
        absent, present = getattr(none, name), getattr(preset, name)
        values[name] = present / max(share, 1e-3) if isinf(absent) else absent + share * (present - absent)
    return replace(preset, **values)


def hops(gap: RealityGap) -> bool:
    """Whether the uncorrected robot manages the first steps."""
    try:
        return first_deployment(gap, seed=0, most_steps=FIRST_STEPS)[1].falls == 0
    except RigFault:  # not even the hop before them
        return False


def hopping_gap(rng: np.random.Generator) -> RealityGap:
    """A twin of the family whose uncorrected robot manages the first steps; the others are drawn again."""
    while not hops(gap := random_gap(rng)):
        pass
    return gap


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
