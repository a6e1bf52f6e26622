"""Trials of single motors on twins whose wiring is right or wrong: judgements, torques, true speeds.

Run with:
    ./go python -m benchmarks.first_torque --seeds 20,21,22
"""

import argparse

import numpy as np

from stepgap.hardware.hopper.jog_trial import jog_answer
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from tests.hardware.hopper.test_jog import (
    DISCONNECTED_1,
    EXCHANGED_DRIVES,
    EXCHANGED_ENCODERS,
    FROZEN_1,
    FROZEN_BOTH,
    INVERTED_1,
    INVERTED_2,
    RIGHT,
    jogged,
)

BOTH = frozenset({1, 2})
CASES = {
    "right": (RIGHT, frozenset[int]()),
    "motor 1 inverted": (INVERTED_1, frozenset({1})),
    "motor 2 inverted": (INVERTED_2, frozenset({2})),
    "drives exchanged": (EXCHANGED_DRIVES, BOTH),
    "encoders exchanged": (EXCHANGED_ENCODERS, BOTH),
    "motor 1 not connected": (DISCONNECTED_1, frozenset({1})),
    "encoder 1 frozen": (FROZEN_1, frozenset({1})),
    "both encoders frozen": (FROZEN_BOTH, BOTH),
}
"""Wirings, and the motors whose trial must fail."""

GAPS = (RealityGap(joint_friction=0.1), RealityGap(joint_damping=0.05))


def main() -> None:
    """Prints a row for each wiring and motor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="0", help="seeds of the twins, separated by commas")
    seeds = [int(seed) for seed in parser.parse_args().seeds.split(",")]
    print(f"{'wiring':22} motor  right judgements  largest torque [N·m]  largest true speed [rad/s]")
    for name, (wiring, failing) in CASES.items():
        for motor in (1, 2):
            right, torques, speeds = 0, [], []
            for seed in seeds:
                ticks, message, speed = jogged(motor, wiring, GAPS[seed % len(GAPS)], seed)
                failed = bool(message) or bool(jog_answer(ticks, motor).failure())
                right += failed == (motor in failing)
                torques.append(float(np.nanmax(np.abs(ticks[f"applied_{motor}"]))))
                speeds.append(speed)
            print(f"{name:22} {motor:5}  {right:7} of {len(seeds):3}  {max(torques):18.2f}  {max(speeds):20.1f}")


if __name__ == "__main__":
    main()
