"""Run folders for the tests of `report`, from the experiment itself on a map with a closed form."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Unpack

import numpy as np

from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants, Setup, run_experiment
from stepgap.experiment.run import Given, Run
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, column_names
from stepgap.plants.model_plant import ModelPlant
from stepgap.records.missing import Missing
from stepgap.records.motion_file import INTERVAL
from stepgap.records.steps_csv import row_of
from stepgap.records.summary import MEASURES
from stepgap.report.run_report import write_report
from stepgap.robots.scene import Link, Motion, Scene
from stepgap.step import Array, Quantity, StepMap, StepRecord, StepSpace, StepStatus
from tests.control.maps import YAW, LossyHopper

TARGETS = Reference.from_segments(
    ("speed", "height"), [(1, (0.1, 0.56)), (11, (0.2, 0.58)), (21, (0.3, 0.6)), (31, (0.15, 0.57))], 40
)


REAL = LossyHopper(drift=0.1, loss=0.43)
"""The real robot; the nominal map is `LossyHopper()`."""


class FallingPlant(ModelPlant):
    """A plant that falls after `lasts` steps."""

    lasts = 10**9
    made = 0

    def take_step(self, command: Array) -> StepRecord:
        record = super().take_step(command)
        self.made += 1
        if self.made <= self.lasts:
            return record
        return replace(record, next_state=np.full_like(record.state, np.nan), status=StepStatus.FELL)


def make_run(
    folder: Path, iterations: int = 2, lasts: tuple[int, ...] = (), real: StepMap = REAL, exploration: int = 0
) -> Path:
    """Runs the experiment into a folder.

    Args:
        folder: New folder.
        iterations: Number of redeployments.
        lasts: Numbers of steps before a fall in the first deployments.
        real: The real robot.
        exploration: Number of exploratory steps; if there are any, the run learns after every step.
    """
    folder.mkdir()
    noise = np.array([0.005, 0.002]) if real is REAL else np.zeros(2)
    steps_before_falls = iter(lasts)

    def plant(rng: np.random.Generator) -> ModelPlant:
        made = FallingPlant(real, np.array([0.1, 0.56]), noise, rng)
        made.lasts = next(steps_before_falls, made.lasts)
        return made

    learning = LearningSettings("gp", iterations, tolerance=0.0, online=exploration > 0, exploration=exploration)
    run_experiment(Setup(LossyHopper(), Plants(plant), TARGETS, learning), folder)
    return folder


def write_run(
    folder: Path,
    names: tuple[str, ...],
    steps: int = 30,
    iterations: int = 2,
    residual: str = "gp",
    targets: Array | None = None,
) -> Path:
    """Writes a synthetic run of a robot with these state coordinates and one command."""
    folder.mkdir()
    space = StepSpace(tuple(Quantity(name, "", -1, 1) for name in names), (Quantity("push", "N", -1, 1),), (YAW,))
    rng = np.random.default_rng(0)
    wanted = rng.normal(size=(steps, len(names))) if targets is None else targets
    lines = [",".join(column_names(space))]
    for iteration in range(iterations):
        rows = zip(rng.normal(size=wanted.shape), wanted, strict=True)
        lines += [row_of(logged(iteration, step, *row), space) for step, row in enumerate(rows, start=1)]
    (folder / "steps.csv").write_text("".join(f"{line}\n" for line in lines), encoding="utf-8")
    write_summary(folder, names, steps, iterations, residual)
    return folder


def logged(iteration: int, step: int, state: Array, target: Array, status: StepStatus = StepStatus.OK) -> LoggedStep:
    """A step whose next state is 1.1 times its target."""
    next_state = 1.1 * target if status == StepStatus.OK else np.full_like(target, np.nan)
    record = StepRecord(state, np.zeros(1), np.zeros(1), next_state, status)
    return LoggedStep(iteration, step, target, target, np.full_like(target, 0.1 * (iteration > 0)), record)


def write_summary(folder: Path, names: tuple[str, ...], steps: int, iterations: int, residual: str = "gp") -> None:
    """Writes a summary in which all errors are null."""
    unknown = dict.fromkeys(names)
    entries = [
        {"iteration": number, "residual": residual if number else "none", "steps": steps, "falls": 0}
        | dict.fromkeys(MEASURES, unknown)
        | {"cut": 0, "unreachable": [], "missed": []}
        for number in range(iterations)
    ]
    content = {
        "schema": 1,
        "seed": 0,
        "iterations": entries,
        "repeatability": unknown,
        "repeatability_same_yaw": unknown,
    }
    (folder / "summary.json").write_text(json.dumps(content), encoding="utf-8")


SIGNALS = {"leg length": "m", "torque": "N·m"}
LINK = Link("body", "foot", 0.01, "near")
SCENE = Scene({"body": 0.03, "foot": 0.01}, (LINK,), "body", ("foot",), "height", 1.5, SIGNALS)
"""A body on a circle, and a foot below it."""


def motion(frames: int) -> Motion:
    """A synthetic motion whose steps take 0.8 s, from step 0 on."""
    time = INTERVAL * np.arange(float(frames))
    yaw, height = 0.2 * time, 0.5 + 0.1 * np.sin(7 * time)
    body = np.column_stack([1.5 * np.sin(yaw), -1.5 * np.cos(yaw), height])
    foot = body - np.column_stack([np.zeros((frames, 2)), np.minimum(height, 0.3)])
    touching = (foot[:, 2:] <= 0).astype(float)
    signals = np.column_stack([height, 10 * np.cos(7 * time)])
    return Motion(time, np.floor(time / 0.8), np.stack([body, foot], axis=1), touching, np.zeros(frames), signals)


TWIN: Given = {"plant": "simulated twin", "settings": Missing("the settings were not given")}
"""What is known of a run on the twin besides its files; its settings are not read."""


def report_of(folder: Path, **given: Unpack[Given]) -> Path:
    """Writes report and figures of a run folder, by default of a run on the twin; returns the path of the page."""
    return write_report(Run(folder, **{**TWIN, **given}), figures=True).path
