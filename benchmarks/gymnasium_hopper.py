"""Gymnasium's hopper learns as a user would let it: lines, time, and errors before and after the first redeployment.

Every seed is a run of its own, from an empty folder: it samples the model, fits the surrogate, deploys, learns, deploys
again, and writes the report. The seed determines the sampled points and the noise.

    ./go python benchmarks/gymnasium_hopper.py --seeds 201 202 203
"""

import argparse
import ast
import os
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.base.garbage_collection import settled_heap
from stepgap.control.cautious_controller import CautiousController
from stepgap.experiment.deployment import tracking_plan
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import Experiment, read_experiment
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array, StepMap, StepStatus

EXAMPLE = Path(__file__).parents[1] / "examples" / "gymnasium_hopper"
HELD_OUT = 200
"""Number of simulated steps in the ranges of use with which the surrogate is compared."""


def lines_of_code(file: Path) -> int:
    """Number of lines that are not empty, comments or docstrings."""
    text = file.read_text("utf-8")
    without = {
        number
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = enumerate(text.splitlines(), start=1)
    return sum(bool(line.strip()) and not line.strip().startswith("#") for n, line in lines if n not in without)


def install(folder: Path) -> None:
    """Installs the example into a folder, from which this process and its children import it."""
    options = ["--quiet", "--no-deps", "--no-build-isolation", "--python", sys.executable, "--target", str(folder)]
    subprocess.run(["uv", "pip", "install", *options, str(EXAMPLE)], check=True)
    sys.path.insert(0, str(folder))
    os.environ["PYTHONPATH"] = str(folder)


def timed_run(folder: Path, seed: int, iterations: int) -> float:
    """Duration of a whole run with its report [s]."""
    begin = perf_counter()
    words = ["run", "--robot", "gymnasium_hopper", "--iterations", str(iterations), "--seed", str(seed)]
    subprocess.run(["stepgap", *words, "--out", str(folder), "--quiet"], check=True)
    return perf_counter() - begin


def held_out_error(settings: Experiment, surrogate: StepMap) -> Array:
    """Root-mean-square error of the surrogate at random points of the ranges of use; shape (n,), half ranges."""
    space, rng = surrogate.space, np.random.default_rng(settings.seed)
    states = space.state_centre + space.state_scale * rng.uniform(-1, 1, (HELD_OUT, len(space.state)))
    commands = space.command_at(rng.uniform(-1, 1, (HELD_OUT, len(space.command))))
    simulated = settings.robot.nominal_maps()["simulator"]().evaluate(states, commands)
    errors = (surrogate.evaluate(states, commands).next_state - simulated.next_state)[simulated.status == StepStatus.OK]
    return np.sqrt(np.nanmean(errors**2, axis=0)) / space.state_scale


def one_step_errors(log: Steps, iteration: int) -> Array:
    """Root-mean-square difference of next and predicted states in a deployment; shape (n,), half ranges."""
    steps = log.of_iteration(iteration).tracking().completed()
    errors = np.array([logged.record.next_state - logged.predicted for logged in steps])
    return np.sqrt(np.nanmean(errors**2, axis=0)) / log.space.state_scale


def tracking_errors(log: Steps, iteration: int) -> Array:
    """Root-mean-square difference of next states and targets in a deployment; shape (n,), state units."""
    steps = log.of_iteration(iteration).tracking().completed()
    return np.sqrt(np.mean([(logged.record.next_state - logged.target) ** 2 for logged in steps], axis=0))


def planning_times(settings: Experiment, nominal: StepMap, log: Steps) -> Array:
    """Wall-clock and processor times of the plans of the second deployment, made again; shape (plans, 2) [s]."""
    learned = log.of_iteration(0)
    learner = Learner.start(nominal, learned, settings.learning, 1)
    seconds, command = [], None
    for logged in log.of_iteration(1).tracking().completed():
        controller = CautiousController(learner.step_map(), nominal, learner.failures, settings.control)
        begin = np.array([perf_counter(), process_time()])
        plan = tracking_plan(controller, logged.record.state, logged.target, command)
        seconds.append([perf_counter(), process_time()] - begin)
        command = plan.command
    return np.array(seconds[1:])  # the first one may compile


def report(folder: Path, seed: int, iterations: int) -> float:
    """Runs one seed and prints its figures.

    Returns:
        One-step error of the first redeployment relative to that of the first deployment.
    """
    seconds = timed_run(folder, seed, iterations)
    settings = read_experiment(folder / "experiment.toml")
    nominal = load_nominal(settings).map
    log = read_step_log(folder / "steps.csv", settings.robot.space)
    names = ", ".join(log.space.state_names)
    before, after = one_step_errors(log, 0), one_step_errors(log, 1)
    with settled_heap():  # as `stepgap run` does
        plans = planning_times(settings, nominal, log)
    ratio = float(np.linalg.norm(after) / np.linalg.norm(before))
    duration = f"{seconds:.0f} s from nothing to the report with {iterations} redeployments"
    print(f"seed {seed}: {duration}, {log.failed_steps} failed steps")
    print(f"  held-out error of the surrogate / half range ({names}): {held_out_error(settings, nominal).round(3)}")
    print(f"  one-step error / half range: {before.round(3)} -> {after.round(3)}, together {ratio:.2f} of before")
    for iteration in log.iterations:
        print(f"  RMSE of tracking, deployment {iteration}: {tracking_errors(log, iteration).round(4)}")
    for name, of_all in zip(("wall-clock", "processor"), 1e3 * plans.T, strict=True):
        print(f"  {name} time of a plan: median {np.median(of_all):.1f} ms, longest {of_all.max():.1f} ms")
    return ratio


def main() -> None:
    """Prints the figures of all seeds."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[201, 202, 203])
    parser.add_argument("--iterations", type=int, default=1, help="redeployments")
    options = parser.parse_args()
    robot, law = EXAMPLE / "gymnasium_hopper.py", EXAMPLE / "hopper_law.py"
    print(f"lines of code: robot {lines_of_code(robot)}, tick controller {lines_of_code(law)}")
    with TemporaryDirectory() as folder, threadpool_limits(1):
        install(Path(folder) / "package")
        ratios = [report(Path(folder) / str(seed), seed, options.iterations) for seed in options.seeds]
    print(f"one-step error, redeployed / first: {np.median(ratios):.2f} of before (median), {max(ratios):.2f} (worst)")


if __name__ == "__main__":
    main()
