"""Measures the error of the estimated state at the apex: measured − true, on the default twin and on random twins.

For each twin: a deployment without correction and one redeployment; mean and standard deviation of the error over all
steps, speed [mm/s] and height [mm], and the RMSE of the redeployment as measured and in truth.

    ./go python benchmarks/apex_bias.py [--twins 10] [--seed 9101]
"""

import argparse
import tempfile
from pathlib import Path

from stepgap.base.random_streams import random_stream
from stepgap.experiment.loop import Setup, run_experiment
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.settings import Experiment
from stepgap.learning.settings import LearningSettings
from stepgap.records.steps_csv import read_step_log
from stepgap.robots.hopper.paper import paper_reference
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.reality_gap import RealityGap


def measure(gap: RealityGap, seed: int) -> str:
    """One row of the table."""
    robot = Hopper(gap=gap)
    settings = Experiment(robot, seed, learning=LearningSettings(iterations=1))
    nominal, reference = robot.apex_map(), paper_reference()
    with tempfile.TemporaryDirectory() as name:
        plants = choose_plants(PlantRequest(settings, reference, Path(name)))._replace(measure_noise_floor=None)
        last = run_experiment(Setup(nominal, plants, reference, settings.learning, seed=seed), Path(name))[-1]
        steps = read_step_log(Path(name) / "steps.csv", nominal.space).completed()
    error = 1e3 * (steps.next_state - steps.true_next_state)
    mean, std = error.mean(axis=0), error.std(axis=0, ddof=1)
    return (
        f"speed {mean[0]:+.2f} ± {std[0]:.2f}  height {mean[1]:+.2f} ± {std[1]:.2f}  ({len(error)} steps)  "
        f"RMSE measured {1e3 * last.rmse[0]:.2f} / {1e3 * last.rmse[1]:.2f}, "
        f"true {1e3 * last.true_rmse[0]:.2f} / {1e3 * last.true_rmse[1]:.2f}"
    )


def main() -> None:
    """Prints a row for the default twin and for each random twin."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--twins", type=int, default=10)
    parser.add_argument("--seed", type=int, default=9101)
    options = parser.parse_args()
    print(f"default  {measure(RealityGap(), options.seed)}", flush=True)
    for twin in range(options.twins):
        print(f"twin {twin:3d} {measure(RealityGap.random(random_stream(twin)), options.seed)}", flush=True)


if __name__ == "__main__":
    main()
