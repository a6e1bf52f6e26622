"""Feature maps on a robot whose state has 12 or 30 numbers, three of which are tracked (benchmarks/features_plant.py).

Each seed is another real robot, reference and noise. Of the tracked numbers, all in half ranges of use:

- One step: errors of predictions of the next deployment, by a model of the 60 steps of the first or the 120 of the
  first two; deployments of the robot that learns from its whole state without a feature map. All models learn from the
  same steps, `outputs` from the tracked numbers alone.
- Closed loop: errors to the targets in each of two redeployments, of a run of its own. That of `outputs` has a robot
  whose state is the three outputs.

Prints the geometric mean over the seeds, and the ratio to `identity`, paired by seed, with its 95 % interval by
Student's t on the logarithm.

    ./go python -m benchmarks.features [--sizes 12,30] [--seeds 0,1,2,3,4] [--residual gp_on_linear]
"""

import argparse
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np
from scipy.stats import t as student

from benchmarks.features_plant import COMMAND, OUTPUTS, ApexMap, OutputsPlant, Physics
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context, usable_cores
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Run
from stepgap.learning.entry_points import load_feature_model, load_residual_model
from stepgap.learning.feature_map import with_features
from stepgap.learning.observations import Observations, observe
from stepgap.learning.residual import HistoryInputs
from stepgap.learning.residual_fit import training_data
from stepgap.learning.settings import NO_FEATURE_MAP, LearningSettings
from stepgap.learning.steps import Steps
from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.plant import Plant
from stepgap.step import Array, StepSpace

STEPS, SEGMENT = 60, 6
"""Number of steps of a deployment, and those for which a target stays."""

LOWER, UPPER = (0.0, -0.2, 0.54), (0.7, 0.2, 0.66)
"""Ranges of the random targets: velocities [m/s] and height [m]."""

KINDS = (NO_FEATURE_MAP, "linear", "outputs")
"""Inputs of the residual: the whole state, features of it, and the tracked numbers alone."""

SCALE = ApexMap(len(OUTPUTS)).space.state_scale
"""Half ranges of the outputs."""


class Case(NamedTuple):
    """One robot with one kind of inputs."""

    size: int
    seed: int
    kind: str
    residual: str


class Found(NamedTuple):
    """Errors [half ranges], the number of falls, and the CPU time of a run [s].

    Attributes:
        one_step: Of one step after one deployment and after two; shape (2,).
        tracking: Of tracking in the three deployments; shape (3,).
        falls: In all deployments.
        seconds: CPU time.
    """

    one_step: Array
    tracking: Array
    falls: int
    seconds: float


def reference(seed: int) -> Reference:
    """Random targets of the outputs."""
    starts = range(1, STEPS + 1, SEGMENT)
    targets = random_stream(seed, 1000).uniform(LOWER, UPPER, (len(starts), len(OUTPUTS)))
    return Reference.from_segments([each.name for each in OUTPUTS], list(zip(starts, targets, strict=True)), STEPS)


def deployments(case: Case) -> tuple[list[Steps], int]:
    """Three deployments of a run, and how many steps failed."""
    real, seed, outputs = (
        ApexMap(case.size, Physics().real(random_stream(case.seed, 1001))),
        case.seed,
        case.kind == "outputs",
    )
    nominal = ApexMap(len(OUTPUTS) if outputs else case.size)

    def plant(rng: np.random.Generator) -> Plant:
        whole = ModelPlant(real, noise=real.noise, rng=rng)
        return OutputsPlant(whole) if outputs else whole

    features = NO_FEATURE_MAP if outputs else case.kind
    learning = LearningSettings(case.residual, iterations=2, feature_map=features, early_stop=False)
    with tempfile.TemporaryDirectory() as name:
        done = run_experiment(Setup(nominal, Plants(plant), reference(seed), learning, seed=seed), Path(name))
        steps = Run(Path(name), space=nominal.space).steps
    return [steps.of_iteration(each.iteration) for each in done], sum(each.failed_steps for each in done)


def one_step_error(case: Case, known: Sequence[Steps], held_out: Steps) -> float:
    """Root mean square of the errors of predicted outputs, summed over them [half ranges]."""
    nominal = ApexMap(case.size)
    learned, test = (_observations(case, [observe(each, nominal) for each in steps]) for steps in (known, [held_out]))
    model = load_residual_model(case.residual)
    if case.kind not in (NO_FEATURE_MAP, "outputs"):
        model = with_features(model, load_feature_model(case.kind))
    squares = 0.0
    for row, quantity in enumerate(OUTPUTS):
        regression = model.fit(training_data(learned, HistoryInputs(), row), None)
        error = test.error[:, row] - regression.mean(test.points(HistoryInputs()))
        squares += float(np.mean((2 * error / (quantity.upper - quantity.lower)) ** 2))
    return float(np.sqrt(squares))


def _observations(case: Case, parts: Sequence[Observations]) -> Observations:
    """Observations of several deployments; for `outputs` of the tracked numbers alone."""
    whole = parts[0].space
    count = len(OUTPUTS) if case.kind == "outputs" else len(whole.state)
    space = StepSpace(whole.state[:count], COMMAND)
    state, command, error = (
        np.vstack([getattr(each, name) for each in parts]) for name in ("state", "command", "error")
    )
    return Observations(space, state[:, :count], command, error[:, :count])


def measure(size: int, seed: int, residual: str) -> dict[str, Found]:
    """Runs a robot with each kind of inputs."""
    found, known = {}, list[Steps]()
    for case in (Case(size, seed, kind, residual) for kind in KINDS):
        begin = process_time()
        done, falls = deployments(case)
        seconds, known = process_time() - begin, known or done  # those of the first kind, identity
        errors = [(each.next_state - each.target)[:, : len(OUTPUTS)] / SCALE for each in done]
        tracking = [float(np.sqrt(np.nanmean(np.sum(each**2, axis=1)))) for each in errors]
        one_step = [one_step_error(case, known[:count], known[count]) for count in (1, 2)]
        found[case.kind] = Found(np.array(one_step), np.array(tracking), falls, seconds)
    return found


def ratio(numbers: Array, to: Array) -> str:
    """Geometric mean of the ratio of paired numbers, with its 95 % interval."""
    logs = np.log(numbers / to)
    half = student.ppf(0.975, len(logs) - 1) * logs.std(ddof=1) / np.sqrt(len(logs)) if len(logs) > 1 else np.nan
    low, mean, high = np.exp(logs.mean() + np.array([-half, 0, half]))
    return f"{mean:.2f} ({low:.2f} to {high:.2f})"


def main() -> None:
    """Prints a table for each size."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in (("--sizes", "12,30"), ("--seeds", "0,1,2,3,4")):
        parser.add_argument(name, default=default, type=lambda text: [int(part) for part in text.split(",")])
    parser.add_argument("--residual", default=LearningSettings().residual)
    given = parser.parse_args()
    cases = list(product(given.sizes, given.seeds))
    with ProcessPoolExecutor(usable_cores(), mp_context=process_context()) as pool:
        results = pool.map(measure, *zip(*((*case, given.residual) for case in cases), strict=True))
        found = dict(zip(cases, results, strict=True))
    for size in given.sizes:
        rows = {kind: [found[size, seed][kind] for seed in given.seeds] for kind in KINDS}
        print(f"{size} numbers")
        for kind, each in rows.items():
            seconds = np.mean([one.seconds for one in each])
            print(f"  {kind}: {sum(one.falls for one in each)} falls, {seconds:.0f} s of CPU time for a run")
            for name in ("one_step", "tracking"):
                numbers, to = (np.array([getattr(one, name) for one in some]) for some in (each, rows[NO_FEATURE_MAP]))
                cells = [f"{np.exp(np.log(column).mean()):.4f}" for column in numbers.T]
                ratios = [ratio(column, other) for column, other in zip(numbers.T, to.T, strict=True)]
                print(
                    f"    {name}: {' | '.join(f'{one}, {two}' for one, two in zip(cells, ratios, strict=True))}",
                    flush=True,
                )


if __name__ == "__main__":
    main()
