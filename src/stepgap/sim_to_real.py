"""The whole method (Sec. 4.4): deploy, learn the map's error, recompute the controller, deploy again.

It knows no robot: a nominal `StepMap`, something that makes a `Plant`, and a `Reference` are all it takes.
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.residual import _KINDS as KINDS
from stepgap.learning.residual import NoResidual, Residual, fit_residual
from stepgap.learning.step_log import LoggedStep, StepLog, StepWriter, read_step_log
from stepgap.plants.plant import Plant
from stepgap.step import Array, Reason, StepFailed, StepMap, StepRecord

SCHEMA = 1
"""Version of `summary.json`."""


@dataclass(frozen=True)
class LearningSettings:
    """How often is learnt, and what.

    Attributes:
        residual: Model of the map's error from the first redeployment on.
        iterations: Redeployments at most; the first deployment, number 0, uses the nominal map.
        least_gain: Redeploying stops when the tracking error has not fallen by this fraction of the
            best so far; judged from the second redeployment on.
    """

    residual: str = "gp"
    iterations: int = 4
    least_gain: float = 0.01

    def __post_init__(self) -> None:
        if self.residual not in KINDS:
            raise ValueError(f"residual = {self.residual!r}, but it must be one of {', '.join(KINDS)}")
        if not 0 <= self.iterations <= 1000:
            raise ValueError(f"iterations = {self.iterations}, but it must lie between 0 and 1000")
        if not 0 <= self.least_gain < 1:
            raise ValueError(f"least_gain = {self.least_gain}, but it must be at least 0 and less than 1")


@dataclass(frozen=True, eq=False)
class Deployment:
    """Tracking errors of one deployment, next state − target, over the steps that ended with an apex.

    Attributes:
        iteration: Its number.
        residual: Kind of the residual model that the controller used.
        steps: Steps executed.
        falls: Steps that ended without an apex; at most one, because the deployment ends with it.
        rmse: Root-mean-square error; shape (n,).
        mae: Mean absolute error; shape (n,).
        bias: Mean error; shape (n,).
        steady_rmse: RMSE over `Reference.steady`; NaN where there are none; shape (n,).
        transient_rmse: RMSE over `Reference.transient`; shape (n,).
    """

    iteration: int
    residual: str
    steps: int
    falls: int
    rmse: Array
    mae: Array
    bias: Array
    steady_rmse: Array
    transient_rmse: Array


def summarise(steps: StepLog, reference: Reference, residual: str) -> Deployment:
    """The errors of one deployment's steps."""
    numbers = np.array([logged.step - 1 for logged in steps.completed()], dtype=int)
    error = steps.completed().next_state - steps.completed().target

    def rms(rows: Array) -> Array:
        return np.sqrt(np.mean(rows**2, axis=0)) if len(rows) else np.full(error.shape[1], np.nan)

    return Deployment(
        iteration=steps.iterations[0],
        residual=residual,
        steps=len(steps),
        falls=steps.falls,
        rmse=rms(error),
        mae=np.mean(np.abs(error), axis=0) if len(error) else rms(error),
        bias=np.mean(error, axis=0) if len(error) else rms(error),
        steady_rmse=rms(error[np.isin(numbers, reference.steady)]),
        transient_rmse=rms(error[np.isin(numbers, reference.transient)]),
    )


def repeatability(steps: StepLog, reference: Reference) -> Array:
    """Spread of the next state at equal state and command [state units]; shape (n,).

    Estimated from the steady steps of one deployment: what is left of the next state after a linear
    fit in state and command, per degree of freedom. NaN where the steps are too few.
    """
    steady = StepLog(
        steps.space, [logged for logged in steps.completed() if logged.step - 1 in set(reference.steady.tolist())]
    )
    inputs = np.hstack([np.ones((len(steady), 1)), steady.state, steady.applied])
    freedom = len(steady) - inputs.shape[1]
    if freedom < 1:
        return np.full(len(steps.space.state), np.nan)
    fitted = inputs @ np.linalg.lstsq(inputs, steady.next_state, rcond=None)[0]
    return np.sqrt(np.sum((steady.next_state - fitted) ** 2, axis=0) / freedom)


def deploy(step_map: CorrectedMap, plant: Plant, reference: Reference, iteration: int) -> Iterator[LoggedStep]:
    """Tracks the reference with the controller of a map, until its end or a fall.

    Where the map knows no command that makes a step, the middle of the bounds is tried.
    """
    controller, command = StepController(step_map), None
    with plant:
        state = plant.start()
        for number, target in enumerate(reference.targets, start=1):
            try:
                plan = controller(state, target, guess=command)
                command, predicted = plan.command, plan.predicted
            except StepFailed:
                command, predicted = step_map.space.command_centre, np.full_like(target, np.nan)
            std = step_map.std(state, command, include_noise=True)
            record = plant.take_step(command)
            yield LoggedStep(iteration, number, target, predicted, std, record)
            if record.reason != Reason.OK:
                return
            state = record.next_state


def learn(nominal: StepMap, log: StepLog, kind: str) -> Residual:
    """Fits the residual to actual − nominal over all steps of the log (Eq. 12), at the commands applied."""
    known = log.completed()
    error = known.next_state - nominal.evaluate(known.state, known.applied).next_state
    usable = np.isfinite(error).all(axis=1)  # a step that the nominal map says must fail has no error to learn
    return fit_residual(kind, nominal.space, known.state[usable], known.applied[usable], error[usable])


@dataclass(frozen=True)
class Observer:
    """Whom to tell of progress; both may take their time.

    Attributes:
        on_step: Told of every executed step, after it is on disk.
        on_deployment: Told of every finished deployment.
    """

    on_step: Callable[[LoggedStep], None] = lambda logged: None
    on_deployment: Callable[[Deployment], None] = lambda deployment: None


def run(
    nominal: StepMap,
    make_plant: Callable[[np.random.Generator], Plant],
    reference: Reference,
    learning: LearningSettings,
    folder: Path,
    seed: int,
    observer: Observer = Observer(),  # noqa: B008  (frozen)
) -> list[Deployment]:
    """Runs the experiment, or goes on with one that was broken off, and keeps its record in `folder`.

    Writes `steps.csv` as steps happen, `models/iteration_K.json` before deployment K and `summary.json`
    after every deployment. Steps already in `steps.csv` are not lost: whole deployments are kept as
    they are; one that was broken off is replayed from its seed, which must give the same steps.

    Args:
        nominal: Map of the physics model.
        make_plant: Makes the plant of one deployment from its random generator.
        reference: What to track.
        learning: How often is learnt, and what.
        folder: An existing folder.
        seed: Of all randomness; deployment K draws from `default_rng([seed, K])`.
        observer: Whom to tell.

    Raises:
        ValueError: The folder's record is not one of this experiment.
    """
    reference.check(nominal.space)
    path = folder / "steps.csv"
    recorded = read_step_log(path, nominal.space) if path.exists() else StepLog(nominal.space)
    log, deployments = StepLog(nominal.space), []
    with StepWriter(path, nominal.space) as writer:
        for iteration in range(learning.iterations + 1):
            kind = learning.residual if iteration > 0 else "none"
            residual = learn(nominal, log, kind)
            if iteration > 0:
                write_whole(folder / "models" / f"iteration_{iteration}.json", json.dumps(residual.to_dict()))
            known = list(recorded.of_iteration(iteration))
            if _is_whole(known, reference):
                steps: Iterator[LoggedStep] = iter(known)
            else:
                plant = make_plant(np.random.default_rng([seed, iteration]))
                steps = deploy(CorrectedMap(nominal, residual), plant, reference, iteration)
            for index, logged in enumerate(steps):
                if index >= len(known):
                    writer.append(logged)
                elif logged is not known[index]:
                    _check_same(path, known[index], logged)
                log.append(logged)
                observer.on_step(logged)
            deployments.append(summarise(log.of_iteration(iteration), reference, kind))
            write_whole(folder / "summary.json", json.dumps(_summary(deployments, log, reference, seed), indent=1))
            observer.on_deployment(deployments[-1])
            if not _worth_going_on(deployments, nominal.space.state_scale, learning.least_gain):
                break
    return deployments


def _is_whole(steps: Sequence[LoggedStep], reference: Reference) -> bool:
    """The deployment went to its end, or to a fall."""
    return bool(steps) and (len(steps) == len(reference) or steps[-1].record.reason != Reason.OK)


def _check_same(path: Path, known: LoggedStep, replayed: LoggedStep) -> None:
    """Raises ValueError unless the replayed step is the recorded one to the last bit."""
    same = all(
        np.array_equal(getattr(known.record, name), getattr(replayed.record, name), equal_nan=True)
        for name in ("state", "command", "applied", "next_state")
    )
    if not same:
        raise ValueError(
            f"{path}: replaying deployment {known.iteration} gave another step {known.step} than the one recorded; "
            "resume with the settings, versions and machine that it was started with"
        )


def _worth_going_on(deployments: Sequence[Deployment], scale: Array, least_gain: float) -> bool:
    """Whether the last deployment still made the tracking error smaller."""
    errors = [
        np.inf if deployment.falls else float(np.linalg.norm(deployment.rmse / scale)) for deployment in deployments
    ]
    return len(errors) < 3 or np.isinf(errors[-1]) or errors[-1] <= (1 - least_gain) * min(errors[:-1])


def _summary(deployments: Sequence[Deployment], log: StepLog, reference: Reference, seed: int) -> dict[str, Any]:
    """The content of `summary.json`; NaN becomes null."""
    names = log.space.state_names

    def named(values: Array) -> dict[str, float | None]:
        return {name: float(value) if np.isfinite(value) else None for name, value in zip(names, values, strict=True)}

    measures = ("rmse", "mae", "bias", "steady_rmse", "transient_rmse")
    return {
        "schema": SCHEMA,
        "seed": seed,
        "iterations": [
            {
                "iteration": deployment.iteration,
                "residual": deployment.residual,
                "steps": deployment.steps,
                "falls": deployment.falls,
                **{measure: named(getattr(deployment, measure)) for measure in measures},
            }
            for deployment in deployments
        ],
        "repeatability": named(repeatability(log.of_iteration(deployments[-1].iteration), reference)),
    }


def write_whole(path: Path, text: str) -> None:
    """Writes a file so that a reader, or a crash, sees the old one or the new one, never a part."""
    path.parent.mkdir(exist_ok=True)
    partial = path.with_suffix(".partial")
    with partial.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
    partial.replace(path)
