"""What the plan of a step costs in a deployment, in nominal maps; with the nominal map, and with the corrected one.

    ./go python benchmarks/plan_maps.py [--seed 0] [options of `stepgap run`]

Every plan of the two deployments of a run is timed, and after it one call of the nominal map at the same step, so that
a busy machine slows both equally. Times are those of the processor.
"""

import argparse
from pathlib import Path
from tempfile import TemporaryDirectory
from time import thread_time

import numpy as np

from stepgap.cli.app import main as stepgap
from stepgap.experiment.deployment import DeploymentController

DEPLOYMENTS = ("nominal", "corrected")
SHARES = (0.5, 0.9, 0.99)


def main() -> None:
    """Prints a line for each deployment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0)
    given, options = parser.parse_known_args()
    plans, maps = list[float](), list[float]()
    plan_of = DeploymentController.plan

    def timed_plan(self, state, target, ahead=()):
        begin = thread_time()
        plan = plan_of(self, state, target, ahead)
        middle = thread_time()
        self.learner.nominal(state, plan.command)
        plans.append(middle - begin)
        maps.append(thread_time() - middle)
        return plan

    DeploymentController.plan = timed_plan
    with TemporaryDirectory() as folder:
        out = str(Path(folder) / "run")
        stepgap(["run", "--quiet", "--iterations", "1", "--seed", str(given.seed), "--out", out, *options])
    print(f"one map: {1e6 * np.median(maps):.0f} µs; plans in maps: median, 90 %, 99 %, mean")
    for name, taken in zip(DEPLOYMENTS, np.array_split(plans, len(DEPLOYMENTS)), strict=True):
        costs = np.array([*np.quantile(taken, SHARES), np.mean(taken)]) / np.median(maps)
        print(f"{name}: {', '.join(f'{cost:.1f}' for cost in costs)} ({len(taken)} plans)")


if __name__ == "__main__":
    main()
