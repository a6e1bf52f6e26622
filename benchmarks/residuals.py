"""Comparison of residuals: each is fitted to all earlier deployments and scored on the next one.

The score is that of the predictions before each step, as in a run, with the drift estimated, for the given commands.

    ./go python benchmarks/residuals.py RUN… [--lagged-inputs auto]
"""

import argparse
from pathlib import Path
from typing import cast

import numpy as np

from stepgap import StepMap
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.settings import read_experiment
from stepgap.learning.entry_points import residual_models
from stepgap.learning.learner import Learner
from stepgap.learning.settings import AUTO, LaggedInputs, LearningSettings
from stepgap.learning.steps import Steps
from stepgap.records.steps_csv import read_step_log
from stepgap.step import Array


def scores(nominal: StepMap, learning: LearningSettings, log: Steps, iteration: int) -> tuple[str, Array, float]:
    """Name of the fitted residual, its RMSE on a deployment (n,), and its mean log density summed over the state."""
    before = log.before(iteration)
    errors, std = [], []
    learner = Learner.start(nominal, before, learning, iteration)
    name = learner.learned.name
    for logged in log.of_iteration(iteration).completed():
        step_map, record = learner.step_map(), logged.record
        errors.append(record.next_state - step_map(record.state, record.applied))
        std.append(np.hypot(step_map.std(record.state, record.applied), step_map.noise_std))
        learner = learner.after(logged)
    density = np.mean(-0.5 * np.square(np.divide(errors, std)) - np.log(std) - 0.5 * np.log(2 * np.pi), axis=0)
    return name, np.sqrt(np.mean(np.square(errors), axis=0)), float(density.sum())


def main() -> None:
    """Prints a line per model and redeployment, then means over the first and over the later redeployments."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--lagged-inputs", default="none")
    options = parser.parse_args()
    kinds = [*(model.name for model in residual_models() if model.candidate), AUTO]
    found: dict[tuple[str, bool], list[Array]] = {}
    print("run, redeployment, residual: RMSE of each coordinate, log score")
    for run in options.runs:
        settings = read_experiment(run / "experiment.toml", recorded=True)
        nominal = load_nominal(settings).map
        log = read_step_log(run / "steps.csv", nominal.space)
        for number in log.iterations[1:]:
            for kind in kinds:
                learning = LearningSettings(residual=kind, lagged_inputs=cast(LaggedInputs, options.lagged_inputs))
                name, rmse, score = scores(nominal, learning, log, number)
                label = f"auto: {name}" if kind == AUTO else name
                print(f"{run.name} {number} {label:40s}", *(f"{1e3 * x:7.2f}e-3" for x in rmse), f"{score:7.3f}")
                found.setdefault((kind, number > 1), []).append(np.append(rmse, score))
    for later in (False, True):
        print("mean over later redeployments" if later else "mean over first redeployments")
        for kind in kinds:
            *rmse, score = np.mean(found.get((kind, later), [np.full(3, np.nan)]), axis=0)
            print(f"{kind:12s}", *(f"{1e3 * x:7.2f}e-3" for x in rmse), f"{score:7.3f}")


if __name__ == "__main__":
    main()
