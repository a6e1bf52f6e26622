"""Which residual predicts the next deployment best? Fits every model to the deployments before, scores it on the next.

Give it folders of runs: ./go python benchmarks/residuals.py RUN… [--features auto]
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np

from stepgap import ApexMap
from stepgap.experiment import read_experiment
from stepgap.learning.observations import Observations, observe
from stepgap.learning.place_effects import without_place_effects
from stepgap.learning.residual_fit import CANDIDATES, fit_residual
from stepgap.learning.step_log import StepLog, read_step_log
from stepgap.step import Array


def next_deployments(folder: Path) -> list[tuple[Observations, Observations]]:
    """Of each redeployment what was observed before it, and in it."""
    settings = read_experiment(folder / "experiment.toml")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    log = read_step_log(folder / "steps.csv", nominal.space)
    known = [observe(StepLog(log.space, (s for s in log if s.iteration <= k)), nominal) for k in log.iterations]
    rows = [(before, rows_from(after, len(before))) for before, after in pairwise(known)]
    return [(without_place_effects(before, k), after) for k, (before, after) in enumerate(rows, start=1)]


def rows_from(data: Observations, first: int) -> Observations:
    """Without the rows before `first`."""
    assert data.context is not None
    rows = (part[first:] for part in (data.state, data.applied_command, data.error, data.context))
    return Observations(data.space, *rows)


def scores(kind: str, features: str, before: Observations, after: Observations) -> tuple[str, Array, float]:
    """What was fitted, its RMSE on the next deployment (n,), and its mean log density there, summed over the state."""
    residual = fit_residual(kind, before, features)
    given = residual.given(after.context)
    points = np.hstack([after.state, after.applied_command])
    rest, std = after.error - given.mean(points), given.std(points, include_noise=True)
    density = np.mean(-0.5 * (rest / std) ** 2 - np.log(std) - 0.5 * np.log(2 * np.pi), axis=0)
    return residual.name, np.sqrt(np.mean(rest**2, axis=0)), float(density.sum())


def main() -> None:
    """Prints a line per model and redeployment, then means."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path)
    parser.add_argument("--features", default="none")
    options = parser.parse_args()
    kinds = (*CANDIDATES, "auto")
    found: dict[str, list[Array]] = {kind: [] for kind in kinds}
    print("run, redeployment, residual: RMSE of each coordinate, log score")
    for run in options.runs:
        for number, (before, after) in enumerate(next_deployments(run), start=1):
            for kind in kinds:
                name, rmse, score = scores(kind, options.features, before, after)
                label = f"auto: {name}" if kind == "auto" else name
                print(f"{run.name} {number} {label:40s}", *(f"{1e3 * x:7.2f}e-3" for x in rmse), f"{score:7.3f}")
                found[kind].append(np.append(rmse, score))
    print("mean over all")
    for kind, rows in found.items():
        *rmse, score = np.mean(rows, axis=0)
        print(f"{kind:12s}", *(f"{1e3 * x:7.2f}e-3" for x in rmse), f"{score:7.3f}")


if __name__ == "__main__":
    main()
