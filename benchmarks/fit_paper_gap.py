"""Fits the twin's `RealityGap` to the tracking errors of the paper's robot without learning.

The uncorrected controller tracks the paper's reference on three twins that differ in floor, yaw and noise. Damped
Gauss–Newton steps in a few differences fit the mean of their errors to those of the hardware (Figs. 4–7), with a prior
on each difference. All other values are those of `RealityGap()`. By default the hardware is described by eight numbers
only; a digitised Fig. 4 with the columns step, v_ref, v_nogp, y_ref, y_nogp adds the mean error on each of the 18
stairs. `--start` gives the JSON file of an earlier fit to start from.

The numbers in `RealityGap()` are rounded results of such a fit to a digitised Fig. 4; it was started by hand near its
end and continued after the forward force had been doubled. `--check` evaluates the present numbers.

    ./go python benchmarks/fit_paper_gap.py [--digitised FIG4.csv] [--start FIT.json] --out FIT.json
    ./go python benchmarks/fit_paper_gap.py --check --out paper_gap.json    # RealityGap() as it is
"""

import argparse
import json
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import closing
from dataclasses import asdict, replace
from itertools import pairwise
from math import tau
from pathlib import Path
from typing import NamedTuple

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import SETTLING_STEPS
from stepgap.experiment.deployment import deploy
from stepgap.experiment.outcome import summarise
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.rig_plant import RigPlant
from stepgap.records.summary import Deployment
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.paper import NO_GP, paper_reference
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.step import Array

MEASURES = ("rmse", "bias", "steady_rmse", "transient_rmse")
HARDWARE = {measure: tuple(NO_GP[measure].values()) for measure in MEASURES}
"""Errors of the hardware without learning, speed [m/s] and height [m]."""

TOLERANCE = (0.002, 0.0006)
"""Difference [m/s, m] from one of these numbers with a cost of one."""

STAIR_TOLERANCE = (0.03, 0.003)
"""Difference of the mean error on one stair with a cost of one: hardware and twin vary about that much with the yaw."""

FALL = 10.0
"""Value of each scaled difference if the robot falls."""

FITTED_SEEDS = range(3)
"""Seeds of the deployments whose mean errors are fitted."""


class Prior(NamedTuple):
    """Normal prior of a difference."""

    mean: float
    std: float


PRIORS = {
    "torque_scale": Prior(0.7, 0.1),
    "torque_saturation": Prior(50.0, 15.0),
    "boom_inertia_scale": Prior(1.5, 0.15),
    "boom_friction": Prior(0.2, 0.1),
    "ground_friction": Prior(0.4, 0.08),
    "motor_offset": Prior(0.0, 0.008),
}
"""The fitted differences; `motor_offset` is the offset of both motors, which changes the leg angle."""


def with_values(gap: RealityGap, values: Array) -> RealityGap:
    """The gap with the fitted differences, in the order of PRIORS."""
    named = dict(zip(PRIORS, map(float, values), strict=True))
    offset = named.pop("motor_offset")
    return replace(gap, **named, motor_offset_1=offset, motor_offset_2=offset)


def values_of(gap: RealityGap) -> Array:
    """The fitted differences, in the order of PRIORS."""
    return np.array([gap.motor_offset_1 if name == "motor_offset" else getattr(gap, name) for name in PRIORS])


def first_deployment(
    gap: RealityGap,
    seed: int,
    bounds: CommandBounds = CommandBounds(),  # noqa: B008  (frozen)
) -> tuple[Steps, Deployment]:
    """Deployment 0 of `stepgap run` with this seed and these bounds of the command.

    Raises:
        RigFault: The hop before the first step failed.
    """
    robot, gains, reference = RobotParameters(), Gains(), paper_reference()
    nominal = ApexMap(robot, gains, bounds)
    ground = GroundProfile(gap, robot.boom_length, random_stream(seed))
    rng = random_stream(seed, 0)
    floor_yaw = rng.uniform(0, tau)
    twin = Twin(robot, gap, rng, ground=ground, floor_yaw=floor_yaw)
    uncorrected = Learner.start(nominal, Steps(nominal.space), LearningSettings(), iteration=0)
    steps = deploy(uncorrected, RigPlant(twin, HopperControl(robot, gains, bounds)), reference, iteration=0)
    with threadpool_limits(limits=1, user_api="blas"), closing(steps):
        log = Steps(nominal.space, steps)
    return log, summarise(log, reference, "none")


def stairs() -> list[slice]:
    """Steps, counted from 0, of each stair after the robot has settled."""
    starts = [*(step for step in paper_reference().changes if step > 0), len(paper_reference())]
    return [slice(start + SETTLING_STEPS, end) for start, end in pairwise(starts)]


def hardware_stairs(path: Path) -> Array:
    """Mean errors of the hardware on each stair; shape (18, 2)."""
    table = np.genfromtxt(path, delimiter=",", names=True)
    error = np.column_stack([table["v_nogp"] - table["v_ref"], table["y_nogp"] - table["y_ref"]])
    return np.array([error[stair].mean(axis=0) for stair in stairs()])


def stair_errors(log: Steps) -> Array:
    """Mean errors of a deployment on each stair; shape (18, 2)."""
    error = log.completed().next_state - log.completed().target
    return np.array([error[stair].mean(axis=0) for stair in stairs()])


def scaled_differences(gap: RealityGap, hardware: Array | None) -> Array:
    """Residuals of the fit: differences from the hardware and from the priors, divided by their tolerances."""
    logs, deployments = zip(*(first_deployment(gap, seed) for seed in FITTED_SEEDS), strict=True)
    values, priors = values_of(gap), list(PRIORS.values())
    prior = [(value - mean) / std for value, (mean, std) in zip(values, priors, strict=True)]
    if any(deployment.failed_steps for deployment in deployments):
        return np.full(2 * len(HARDWARE) + (0 if hardware is None else hardware.size) + len(PRIORS), FALL)
    parts: list[Array] = []
    for name, measured in HARDWARE.items():
        mean = np.mean([getattr(deployment, name) for deployment in deployments], axis=0)
        parts.append((mean - measured) / TOLERANCE)
    if hardware is not None:
        parts.append(((np.mean([stair_errors(log) for log in logs], axis=0) - hardware) / STAIR_TOLERANCE).ravel())
    return np.concatenate([*parts, prior])


def fit(start: RealityGap, hardware: Array | None, rounds: int) -> RealityGap:
    """Gauss–Newton steps from a start, each full or halved, as long as they reduce the cost."""
    prior_std = np.array([prior.std for prior in PRIORS.values()])
    values, gap = values_of(start), start
    with ProcessPoolExecutor(2) as pool:
        found = scaled_differences(gap, hardware)
        for _ in range(rounds):
            print(f"cost {found @ found:.2f} at {dict(zip(PRIORS, values.round(5).tolist(), strict=True))}", flush=True)
            moved = [with_values(start, values + 0.25 * prior_std * unit) for unit in np.eye(len(values))]
            changes = np.array(list(pool.map(scaled_differences, moved, [hardware] * len(moved)))) - found
            step = np.clip(np.linalg.lstsq(changes.T / 0.25, -found, rcond=None)[0], -1, 1) * prior_std
            trials = [with_values(start, values + share * step) for share in (1.0, 0.5)]
            results = list(pool.map(scaled_differences, trials, [hardware] * len(trials)))
            trial, result = min(zip(trials, results, strict=True), key=lambda pair: pair[1] @ pair[1])
            if not result @ result < 0.98 * (found @ found):
                break
            values, gap, found = values_of(trial), trial, result
    return gap


def quality(gap: RealityGap, seeds: Sequence[int], hardware: Array | None = None) -> list[dict[str, object]]:
    """Errors of the first deployment by seed, and the RMS differences of its stairs from the hardware's."""
    rows: list[dict[str, object]] = []
    for seed in seeds:
        log, deployment = first_deployment(gap, seed)
        row: dict[str, object] = {"seed": seed, "steps": deployment.steps, "falls": deployment.failed_steps}
        row |= {measure: getattr(deployment, measure).round(5).tolist() for measure in MEASURES}
        if hardware is not None and deployment.failed_steps == 0:
            row["stairs_rms"] = np.sqrt(np.mean((stair_errors(log) - hardware) ** 2, axis=0)).round(5).tolist()
        rows.append(row)
        print(row, flush=True)
    return rows


def main() -> None:
    """Fits, and writes the fitted differences and the errors of seeds 0 to 5: speed [m/s], height [m]."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--digitised", type=Path, help="Fig. 4 of the paper, read off its plot")
    parser.add_argument("--start", type=Path, help="JSON file of an earlier fit [default: the means of the priors]")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--check", action="store_true", help="evaluate without a fit")
    parser.add_argument("--out", type=Path, help="JSON file for the result")
    options = parser.parse_args()
    hardware = hardware_stairs(options.digitised) if options.digitised else None
    gap = RealityGap()
    if options.start:
        fitted = json.loads(options.start.read_text(encoding="utf-8"))["fitted"]
        gap = with_values(gap, [fitted[name] for name in PRIORS])
    elif not options.check:
        gap = with_values(gap, [prior.mean for prior in PRIORS.values()])
    if not options.check:
        gap = fit(gap, hardware, options.rounds)
    result = {
        "hardware": HARDWARE,
        "fitted_seeds": [*FITTED_SEEDS],
        "fitted": dict(zip(PRIORS, values_of(gap).round(6).tolist(), strict=True)),
        "seeds": quality(gap, range(6), hardware),
        "gap": {name: str(value) if value == float("inf") else value for name, value in asdict(gap).items()},
    }
    if options.out:
        options.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
