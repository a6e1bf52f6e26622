"""Runs the paper's experiment on twins whose drives give less torque than the model assumes.

For each limit and seed, `stepgap run --gap.torque_limit LIMIT --seed SEED`, and of its last deployment: the share of
cut commands; the share of measurements within the 95 % intervals; the number of targets that are unreachable according
to the corrected map; the steady error at all other targets in noise floors; the headline of the report.

A second table shows what a cut request does. At settled hops of a twin with the limit 13 N·m, it compares the next
states after a request u, after the smaller request that equals what was applied of u, and after no request at all:
whether they are cut, too, and how the mean next state differs, over 12 draws of the noise.

    ./go python -m benchmarks.torque_limits [--limits 10,13,16,22] [--seeds 1,2,3] [--iterations 2]
"""

import argparse
import tempfile
from contextlib import closing
from pathlib import Path

import numpy as np

from benchmarks.disturbed_plant import own_priors
from stepgap.base.random_streams import random_stream
from stepgap.experiment.bands import interval_coverage
from stepgap.experiment.deployment import deploy
from stepgap.experiment.loop import Setup, run_experiment
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import Steps
from stepgap.report.sentences import headline
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.simulation import TwinPlant
from stepgap.robots.hopper.twin.twin import Twin

REPEATS = 12
"""Draws of the noise for each request."""


def measure(limit: float, seed: int, iterations: int) -> str:
    """One row: the last deployment of a run with this torque limit [N·m]."""
    robot = Hopper(gap=RealityGap(torque_limit=limit))
    settings = Experiment(robot, seed, learning=LearningSettings(iterations=iterations))
    nominal, reference = robot.apex_map(), paper_reference()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        plants = choose_plants(PlantRequest(settings, reference, folder))
        setup = Setup(nominal, plants, reference, settings.learning, seed=seed, priors=own_priors(robot))
        run_experiment(setup, folder)
        run = Run(folder, space=nominal.space)
        last = run.deployments[-1]
        steps = run.steps.of_iteration(last.iteration)
        inside, known = interval_coverage(steps)
        covered = inside / known
        held = ~(reference.targets[:, None] == last.unreachable[None]).all(axis=2).any(axis=1)
        steady = np.intersect1d(reference.steady, np.flatnonzero(held))
        numbers = np.array([logged.step - 1 for logged in steps.completed()])
        error = (steps.completed().next_state - steps.completed().target)[np.isin(numbers, steady)]
        floors = np.sqrt(np.mean(error**2, axis=0)) / run.noise_floor if len(error) else np.full(2, np.nan)
        rmse = "  ".join(f"{1e3 * each.rmse[0]:.0f} / {1e3 * each.rmse[1]:.1f}" for each in run.deployments)
        return (
            f"{limit:5g} {seed:4d}  cut {last.cut:3d} of {last.steps}  within 95 %: {covered[0]:.2f} {covered[1]:.2f}  "
            f"unreachable {len(last.unreachable):2d}  missed {len(last.missed):2d}  "
            f"steady error at the others: {floors[0]:.2f} {floors[1]:.2f} floors  falls {run.steps.failed_steps}  "
            f"RMSE [mm/s / mm] by deployment: {rmse}  {headline(run)[:16]}"
        )


def compare_requests(limit: float, seed: int) -> None:
    """Prints the next states after the request of the controller, after what was applied of it, and after none."""
    nominal, reference, gap = ApexMap(), paper_reference(), RealityGap(torque_limit=limit)
    rng = random_stream(seed, 99)
    twin = Twin(nominal.robot, gap, random_stream(seed, 0))
    plant = TwinPlant(twin, Hopper(gap=gap).control())
    learner = Learner.start(nominal, Steps(nominal.space), LearningSettings(), 0)
    print(f"limit {limit:g} N·m: request, removed [N]; mean next state minus that after the full request [mm/s, mm]")
    with closing(deploy(learner, plant, reference, 0)) as steps:
        for logged in steps:
            if logged.step not in (30, 70, 110, 150, 190):
                continue
            full = logged.record.requested
            requests = {"full": full, "what was applied": logged.record.applied, "none": np.zeros(2)}
            first = None
            for name, request in requests.items():
                found = [plant.repeated(request, rng) for _ in range(REPEATS)]
                mean = np.mean(found, axis=0)
                first = mean if first is None else first
                error = np.std(found, axis=0, ddof=1) / np.sqrt(REPEATS)
                print(
                    f"  step {logged.step:3d} {name:17s} {request.round(1)}  {(1e3 * (mean - first)).round(1)} "
                    f"± {(1e3 * error).round(1)}"
                )


def main() -> None:
    """Prints both tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--limits", default="10,13,16,22")
    parser.add_argument("--seeds", default="1,2,3")
    parser.add_argument("--iterations", type=int, default=2)
    options = parser.parse_args()
    for limit in map(float, options.limits.split(",")):
        for seed in map(int, options.seeds.split(",")):
            print(measure(limit, seed, options.iterations), flush=True)
    compare_requests(13.0, int(options.seeds.split(",")[0]))


if __name__ == "__main__":
    main()
