"""A hopper that changes in mid-run and back: how fast does learning find the new robot, and then the old one again?

The preset `paper` hops through the paper's reference. Deployment 0 has no correction; deployment 1 learned from it,
with default settings, and goes on learning. After hop 113 the robot changes, after hop 170 it is again what it was.
Hops to the band: after how many hops since the change, or since its end, the errors of 10 consecutive hops stay within
the final errors of the paper's hardware (`PublishedResult.band`); "never" where they do not until the next change or
the end.

    ./go python -m benchmarks.changes [--seeds 31,32,33,34] [--changes torque,payload,none]
"""

import argparse
from collections.abc import Mapping
from dataclasses import replace
from itertools import product
from math import inf
from typing import NamedTuple

import numpy as np

from benchmarks.disturbed_plant import DisturbedPlant, alarms_after, finished, own_priors, tracked, uncorrected
from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.robots.hopper.paper import PAPER_STEPS, paper_reference, paper_result
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import TwinPlant, TwinSimulation
from stepgap.step import Array

CHANGES: Mapping[str, Mapping[str, float]] = {
    "torque": {"torque_scale": 0.85},
    "payload": {"body_mass_scale": 1.15},
    "friction": {"ground_friction": 0.5},
    "none": {},
}
"""Factors on numbers of the twin's `RealityGap`, by their names."""

CHANGED, UNDONE = 113, 170
"""Last hop before the change, and last hop before its end."""

WINDOW = 10
"""Number of consecutive hops over which an error is compared with the band."""

PARTS = {"1–10": (0, 10), "11–30": (10, 30), "31–57": (30, 57)}
"""Hops after a change whose errors are averaged."""


class Case(NamedTuple):
    """One run."""

    change: str
    seed: int


class Found(NamedTuple):
    """Errors after the change and after its end.

    Attributes:
        rmse: Of speed [m/s] and height [m] in each part of `PARTS`; shape (2, parts, 2), NaN after a fall.
        hops: Hops to the band after the change, and after its end; infinite for never.
        fell: Whether the robot fell.
        alarms: Numbers of the hops at which the learner raised an alarm.
    """

    rmse: Array
    hops: tuple[float, float]
    fell: bool
    alarms: tuple[int, ...]


def hops_to_band(errors: Array, band: Array) -> float:
    """Number of hops after which the RMSE of `WINDOW` consecutive hops stays in a band; (N, n) and (n,)."""
    if len(errors) < WINDOW:
        return inf
    squares = np.cumsum(np.vstack([np.zeros(errors.shape[1]), errors**2]), axis=0)
    inside = (np.sqrt((squares[WINDOW:] - squares[:-WINDOW]) / WINDOW) <= band).all(axis=1)
    outside = np.flatnonzero(~inside)
    first = int(outside[-1]) + 1 if len(outside) else 0
    return first + WINDOW if first < len(inside) else inf


def measure(case: Case) -> Found:
    """Runs a case."""
    hopper, reference = Hopper(), paper_reference()
    simulation = TwinSimulation(hopper.parameters, hopper.gap, hopper.control, random_stream(case.seed))
    nominal = hopper.apex_map()
    changed = replace(hopper.gap, **{k: f * getattr(hopper.gap, k) for k, f in CHANGES[case.change].items()})
    with one_blas_thread():
        known = tracked(uncorrected(nominal), simulation.plant(random_stream(case.seed, 0)), reference, 0)
        learner = Learner.start(nominal, known, LearningSettings(), 1, own_priors(hopper))
        _, twin = simulation.direct_rig(random_stream(case.seed, 1))
        events = {CHANGED: lambda: twin.become(changed), UNDONE: lambda: twin.become(hopper.gap)}
        steps = tracked(learner, DisturbedPlant(TwinPlant(twin, hopper.control()), events), reference, 1)
        alarms = alarms_after(learner, steps)
    errors = np.full((PAPER_STEPS, 2), np.nan)
    errors[: len(steps.completed())] = steps.tracking_errors()
    after = errors[CHANGED:UNDONE], errors[UNDONE:]
    rmse = np.sqrt([[np.mean(part[first:end] ** 2, axis=0) for first, end in PARTS.values()] for part in after])
    first, second = (hops_to_band(part, paper_result().band) for part in after)
    return Found(rmse, (first, second), bool(steps.failed_steps), alarms)


def print_row(change: str, found: list[Found]) -> None:
    """Prints the medians and 90 % quantiles of the cases of a change."""
    for number, after in enumerate(("change", "end")):
        rmse = np.nanmedian([each.rmse[number] for each in found], axis=0)
        parts = "  ".join(f"{1e3 * speed:5.1f} /{1e3 * height:5.1f}" for speed, height in rmse)
        hops = [each.hops[number] for each in found]
        middle, most = (np.quantile(hops, q, method="higher") for q in (0.5, 0.9))
        never = sum(np.isinf(hops))
        print(f"{change:9}{after:8}{parts}   {middle:5.0f} {most:5.0f} {never:5d}", end="")
        print(f"   {sum(each.fell for each in found)} falls" if number == 0 else "")


def main() -> None:
    """Prints a line for each case when it is done, and then two rows for each change."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", default="31,32,33,34")
    parser.add_argument("--changes", default=",".join(CHANGES))
    given = parser.parse_args()
    changes = given.changes.split(",")
    cases = [Case(change, int(seed)) for seed, change in product(given.seeds.split(","), changes)]
    found = dict[Case, Found]()
    for case, each in finished(measure, cases):
        found[case] = each
        rmse = [[f"{1e3 * speed:.1f}/{1e3 * height:.1f}" for speed, height in part] for part in each.rmse]
        print(
            *case,
            *(f"{' '.join(part)} to band {hops:.0f}," for part, hops in zip(rmse, each.hops, strict=True)),
            flush=True,
        )
    print("RMSE, median [mm/s / mm], of the hops after the change and after its end; hops to the band: median, p90,")
    print("never (of how many seeds)")
    print(f"{'':17}{'  '.join(f'{part:>12}' for part in PARTS)}   median   p90 never")
    for change in changes:
        print_row(change, [each for case, each in found.items() if case.change == change])
    alarms = [f"{' '.join(map(str, case))}: alarms at {each.alarms}" for case, each in found.items() if each.alarms]
    print("\n".join(alarms) if alarms else "no alarms")


if __name__ == "__main__":
    main()
