"""The learning benchmark: comparison of learning methods on a family of random twins.

For each twin and seed there is one deployment without correction, from which most methods learn, and then the
deployments of each method; `trial` describes which random numbers they draw.
"""

from collections.abc import Sequence

import numpy as np

from benchmarks.disturbed_plant import own_priors
from benchmarks.learning.learning_summary import UNCORRECTED, DeploymentRow
from benchmarks.learning.methods.redeployment import uncorrected
from benchmarks.learning.methods.registry import method_of
from benchmarks.learning.tasks import Task
from benchmarks.learning.trial import Trial, hopping_gap
from stepgap.base.blas import one_blas_thread
from stepgap.experiment.bands import executed_steps_to_band, interval_coverage
from stepgap.experiment.outcome import summarise
from stepgap.learning.steps import Steps
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.paper import paper_result
from stepgap.robots.hopper.robot import Hopper
from stepgap.step import Array


def measure_twin(task: Task, twin: int, seed: int, names: Sequence[str]) -> list[DeploymentRow]:
    """Measures of all methods on a twin; the first row is that of the uncorrected deployment."""
    nominal, chosen = ApexMap(), {name: method_of(name) for name in names}
    with one_blas_thread():
        gap, drawn_again = hopping_gap(nominal, task, twin)
        trial = Trial(nominal, gap, task, twin, seed, priors=own_priors(Hopper()))
        first = _row(trial, UNCORRECTED, uncorrected(trial)) | {"drawn_again": drawn_again}
        return [first, *(_row(trial, name, method(trial)) for name, method in chosen.items())]


def _row(trial: Trial, method: str, deployments: Sequence[Steps]) -> DeploymentRow:
    """Measures of the last of the deployments that a method needs."""
    steps = deployments[-1]
    row: DeploymentRow = {
        "task": trial.task.name,
        "twin": trial.twin,
        "seed": trial.seed,
        "method": method,
        "deployments": len(deployments),
    }
    if not len(steps):
        return row | {"steps": 0, "falls": 1}
    found = summarise(steps, trial.task.reference, method)
    covered, counted = interval_coverage(steps.tracking())
    return row | {
        "steps": found.steps,
        "falls": found.failed_steps,
        "error": float(np.linalg.norm(found.rmse / steps.space.state_scale)),
        "rmse": known_numbers(found.rmse),
        "transient_rmse": known_numbers(found.transient_rmse),
        "steady_rmse": known_numbers(found.steady_rmse),
        "true_rmse": known_numbers(found.true_rmse),
        "hops_to_band": None if found.failed_steps else executed_steps_to_band(deployments, paper_result().band),
        "covered": covered.tolist(),
        "counted": int(counted.min()),
    }


def known_numbers(values: Array) -> list[float] | None:
    """The numbers for JSON; None if they are unknown, as the steady error of a reference that never rests."""
    return values.tolist() if np.isfinite(values).all() else None
