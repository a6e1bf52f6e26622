"""Pushes at the apex: the largest that a hopper survives, and how soon it is back, before and after learning.

The twin hops at one target. After ten hops its speed changes at once. Before learning, its controller knows the nominal
map; after it, also 227 hops along the paper's reference. The command of the pushed hop is planned before the push. It
is back with the first of three hops whose errors are all within twice the final errors of the paper's robot; counted
again for the difference from its own steady errors, the mean of the last ten hops, which are large before learning.

    ./go python -m benchmarks.pushes [--seeds 1,2,3] [--figure pushes.png]
"""

import argparse
from collections.abc import Mapping
from contextlib import closing
from functools import cache
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np

from benchmarks.disturbed_plant import finished, own_priors
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.paper import paper_reference, paper_result
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import TwinPlant
from stepgap.step import Array

TARGET = (0.2, 0.58)
"""Speed [m/s] and height [m]."""

BEFORE, AFTER = 10, 25
"""Hops before and after the push."""

PUSHES: Mapping[str, Array] = {
    "forward": np.arange(0.1, 2.01, 0.2),
    "backward": -np.arange(0.1, 2.51, 0.2),
}
"""Changes of the speed [m/s]."""

SHOWN = {"forward": 0.5, "backward": -0.5}
"""Pushes of the figure and of the time until the hopper is back [m/s]."""


class Case(NamedTuple):
    """One push."""

    learned: bool
    seed: int
    push: float


@cache
def learner_of(learned: bool, seed: int) -> Learner:
    """The controller's knowledge; before learning, the nominal map alone."""
    hopper = Hopper()
    nominal, none = hopper.apex_map(), LearningSettings(residual="none")
    start = Learner.start(nominal, Steps(nominal.space), none, 0)
    if not learned:
        return start
    known = Steps(nominal.space)
    plant = hopper.simulations()["twin"](random_stream(seed)).plant(random_stream(seed, 0))
    with one_blas_thread(), closing(deploy(start, plant, paper_reference(), 0)) as steps:
        for logged in steps:
            known += [logged]
    with one_blas_thread():
        return Learner.start(nominal, known, LearningSettings(), 1, own_priors(hopper))


def errors_after(case: Case) -> Array:
    """Errors of the hops after the push; shape (N, 2), N < `AFTER` after a fall."""
    hopper, learner = Hopper(), learner_of(case.learned, case.seed)
    simulation = hopper.simulations()["twin"](random_stream(case.seed))
    _, twin = simulation.direct_rig(random_stream(case.seed, 1))
    plant, errors = TwinPlant(twin, hopper.control()), []
    reference = Reference(("speed", "height"), np.tile(TARGET, (BEFORE + AFTER, 1)))
    with one_blas_thread(), closing(deploy(learner, plant, reference, 1)) as steps:
        for logged in steps:
            if logged.step == BEFORE:
                twin.push(case.push)
            if logged.step > BEFORE and np.isfinite(logged.record.next_state).all():
                errors.append(logged.record.next_state - logged.target)
    return np.array(errors).reshape(-1, 2)


def back_after(errors: Array) -> float:
    """Number of the first of three hops with errors, shape (N, 2), within twice the band; infinite for never."""
    inside = np.asarray((np.abs(errors) < 2 * np.array(paper_result().band)).all(axis=1))
    runs = inside[:-2] & inside[1:-1] & inside[2:]
    return float(np.argmax(runs)) + 1 if runs.any() else np.inf


def draw(path: Path, found: Mapping[Case, Array], seeds: list[int]) -> None:
    """Draws the errors of speed and height after the pushes of `SHOWN`."""
    figure, axes = plt.subplots(2, len(SHOWN), sharex=True, sharey="row", figsize=(8, 5), layout="constrained")
    for column, (name, push) in enumerate(SHOWN.items()):
        for learned, colour, label in ((False, "tab:orange", "before learning"), (True, "tab:blue", "after learning")):
            for seed in seeds:
                errors = 1e3 * found[Case(learned, seed, push)]
                for row in range(2):
                    axes[row, column].plot(1 + np.arange(len(errors)), errors[:, row], colour, alpha=0.7, label=label)
                    label = None
        axes[0, column].set_title(f"pushed {name} by {abs(push):g} m/s")
        axes[1, column].set_xlabel("hops after the push")
    axes[0, 0].set_ylabel("error of speed [mm/s]")
    axes[1, 0].set_ylabel("error of height [mm]")
    axes[0, 0].legend()
    figure.savefig(path, dpi=120)


def main() -> None:
    """Prints a row for each direction."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--figure", type=Path)
    options = parser.parse_args()
    seeds = [int(seed) for seed in options.seeds.split(",")]
    pushes = [float(push) for values in PUSHES.values() for push in np.round(values, 3)]
    found = dict(finished(errors_after, [Case(each, s, p) for s in seeds for each in (False, True) for p in pushes]))
    print("direction   learned  largest survived of each seed [m/s]   hops until back, at the target and as before")
    for name, values in PUSHES.items():
        for learned in (False, True):
            largest = []
            for seed in seeds:
                survived = [len(found[Case(learned, seed, float(p))]) == AFTER for p in np.round(values, 3)]
                until = survived.index(False) if False in survived else len(values)
                largest.append(f"{values[until - 1] if until else 0:+.1f}")
            shown = [found[Case(learned, seed, SHOWN[name])] for seed in seeds]
            back = ", ".join(f"{back_after(each):g}" for each in shown)
            steady = ", ".join(f"{back_after(each - each[-10:].mean(axis=0)):g}" for each in shown)
            print(f"{name:11} {learned!s:8} {', '.join(largest):37} {back:30} {steady}")
    if options.figure:
        draw(options.figure, found, seeds)


if __name__ == "__main__":
    main()
