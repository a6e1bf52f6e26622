"""Run folders for the tests of `report`, made by the experiment itself on a map with a closed form."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.control.reference import Reference
from stepgap.learning.step_log import LoggedStep, StepWriter
from stepgap.plants.model_plant import ModelPlant
from stepgap.sim_to_real import LearningSettings, run
from stepgap.step import Array, Outcome, Quantity, Reason, StepMap, StepRecord, StepSpace
from tests.control.maps import LossyHopper, NeverWorks

TARGETS = Reference.from_segments(
    ("speed", "height"), [(1, (0.1, 0.56)), (11, (0.2, 0.58)), (21, (0.3, 0.6)), (31, (0.15, 0.57))], 40
)


@dataclass
class Tiring(LossyHopper):
    """The real one, which falls after so many steps."""

    lasts: int = 10**9
    drift: float = 0.1
    loss: float = 0.43
    made: int = 0

    def evaluate(self, state: Any, command: Any) -> Outcome:
        self.made += 1
        if self.made > self.lasts:
            return Outcome(np.full(2, np.nan), np.array(Reason.FELL))
        return super().evaluate(state, command)


def make_run(folder: Path, iterations: int = 2, residual: str = "gp", real: Callable[[], StepMap] = Tiring) -> Path:
    """Runs the experiment into a folder."""
    folder.mkdir()
    learning = LearningSettings(residual, iterations, least_gain=0.0)

    def plant(rng: np.random.Generator) -> ModelPlant:
        return ModelPlant(real(), np.array([0.1, 0.56]), np.array([0.005, 0.002]), rng)

    run(LossyHopper(), plant, TARGETS, learning, folder, seed=0)
    return folder


def write_run(
    folder: Path, names: tuple[str, ...], steps: int = 30, iterations: int = 2, residual: str = "gp", size: float = 1.0
) -> Path:
    """A made-up run of a robot with other state coordinates, and one command."""
    folder.mkdir()
    space = StepSpace(tuple(Quantity(name, "", -1, 1) for name in names), (Quantity("push", "N", -1, 1),))
    rng, n = np.random.default_rng(0), len(names)
    with StepWriter(folder / "steps.csv", space) as writer:
        for iteration in range(iterations):
            for step in range(1, steps + 1):
                state, target = size * rng.normal(size=(2, n))
                writer.append(logged(iteration, step, state, target))
    write_summary(folder, names, steps, iterations, residual)
    return folder


def logged(iteration: int, step: int, state: Array, target: Array, reason: Reason = Reason.OK) -> LoggedStep:
    """A step that ends a tenth beyond its target."""
    next_state = 1.1 * target if reason == Reason.OK else np.full_like(target, np.nan)
    record = StepRecord(state, np.zeros(1), np.zeros(1), next_state, reason)
    return LoggedStep(iteration, step, target, target, np.full_like(target, 0.1 * (iteration > 0)), record)


def write_summary(folder: Path, names: tuple[str, ...], steps: int, iterations: int, residual: str = "gp") -> None:
    """A summary that knows no error, all null."""
    unknown = dict.fromkeys(names)
    measures = ("rmse", "mae", "bias", "steady_rmse", "transient_rmse")
    entries = [
        {"iteration": number, "residual": residual if number else "none", "steps": steps, "falls": 0}
        | {measure: unknown for measure in measures}
        for number in range(iterations)
    ]
    content = {"schema": 1, "seed": 0, "iterations": entries, "repeatability": unknown}
    (folder / "summary.json").write_text(json.dumps(content), encoding="utf-8")


__all__ = ["TARGETS", "NeverWorks", "Tiring", "logged", "make_run", "write_run", "write_summary"]
