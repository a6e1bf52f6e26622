"""The whole method (Sec. 4.4): deploy, learn the map's error, recompute the controller, deploy again.

It knows no robot: a nominal `StepMap`, something that makes a `Plant`, and a `Reference` are all it takes.
"""

import json
import platform
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.files import write_whole
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import observe
from stepgap.learning.residual import FEATURES, Features, Hindsight, Residual
from stepgap.learning.residual_fit import KINDS, ResidualKind, fit_residual
from stepgap.learning.step_log import LoggedStep, RecordError, StepLog, StepWriter, digest, row_of
from stepgap.plants.plant import Plant
from stepgap.step import Array, Reason, StepFailed, StepMap

SCHEMA = 1
"""Version of `summary.json`."""

RECORDED_VERSIONS = ("stepgap", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions `summary.json` names: with others the same seed may give other last digits."""

SAME_AGAIN = "resume with the record, settings, versions and machine that it was started with"
"""What to do when a replay does not give the recorded steps."""


Steps = Generator[LoggedStep, None, None]
"""Steps as they are executed; closing it stops the plant."""


@dataclass(frozen=True)
class LearningSettings:
    """How often is learnt, and what.

    Attributes:
        residual: Model of the map's error from the first redeployment on.
        iterations: Redeployments at most; the first deployment, number 0, uses the nominal map.
        least_gain: Redeploying stops when the tracking error has not fallen by this fraction of the
            best so far; judged from the second redeployment on.
        features: What of the step before the model takes as inputs, too; `auto`: what predicts best.
        memory: After how many steps what was learnt counts much less; inf: it counts for ever.
    """

    residual: ResidualKind = "gp"
    iterations: int = 4
    least_gain: float = 0.01
    features: Features | Literal["auto"] = "none"
    memory: float = inf

    def __post_init__(self) -> None:
        if self.residual not in KINDS:
            raise ValueError(f"residual = {self.residual!r}, but it must be one of {', '.join(KINDS)}")
        if self.features not in (*FEATURES, "auto"):
            raise ValueError(f"features = {self.features!r}, but it must be one of {', '.join(FEATURES)}, auto")
        Hindsight(memory=self.memory)
        if not 0 <= self.iterations <= 1000:
            raise ValueError(f"iterations = {self.iterations}, but it must lie between 0 and 1000")
        if not 0 <= self.least_gain < 1:
            raise ValueError(f"least_gain = {self.least_gain}, but it must be at least 0 and less than 1")


@dataclass(frozen=True, eq=False)
class Deployment:
    """Tracking errors of one deployment, next state − target, over the steps that ended with an apex.

    Attributes:
        iteration: Its number.
        residual: Name of the residual model that the controller used.
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
    """Spread of the next state at equal state and command, at most about this [state units]; shape (n,).

    Estimated from the steady steps of one deployment: what is left of the next state after a linear
    fit in state and command, per degree of freedom. Where the map bends, that is more than the true
    spread. NaN where the steps are too few.
    """
    numbers = set((reference.steady + 1).tolist())
    steady = StepLog(steps.space, (logged for logged in steps.completed() if logged.step in numbers))
    inputs = np.hstack([np.ones((len(steady), 1)), steady.state, steady.applied])
    freedom = len(steady) - inputs.shape[1]
    if freedom < 1:
        return np.full(len(steps.space.state), np.nan)
    fitted = inputs @ np.linalg.lstsq(inputs, steady.next_state, rcond=None)[0]
    return np.sqrt(np.sum((steady.next_state - fitted) ** 2, axis=0) / freedom)


def deploy(step_map: CorrectedMap, plant: Plant, reference: Reference, iteration: int, before: StepLog) -> Steps:
    """Tracks the reference with the controller of a map, until its end or a fall.

    Where the map knows no command that makes a step, the middle of the bounds is tried.

    Args:
        step_map: Map to compute commands with.
        plant: What executes them.
        reference: What to track.
        iteration: Number of the deployment.
        before: Steps of the deployments before, for a map with hindsight.
    """
    log, command = StepLog(step_map.space, before), None
    with plant:
        state = plant.start()
        for number, target in enumerate(reference.targets, start=1):
            current = step_map.after(log, iteration)
            try:
                plan = StepController(current)(state, target, guess=command)
                command, predicted = plan.command, plan.predicted
            except StepFailed:
                command, predicted = step_map.space.command_centre, np.full_like(target, np.nan)
            std = current.std(state, command, include_noise=True)
            record = plant.take_step(command)
            logged = LoggedStep(iteration, number, target, predicted, std, record)
            log.append(logged)
            yield logged
            if record.reason != Reason.OK:
                return
            state = record.next_state


def learn(nominal: StepMap, log: StepLog, learning: LearningSettings) -> Residual:
    """Fits the residual to actual − nominal over all steps of the log (Eq. 12), at the commands applied.

    Without a step to learn from, the nominal map stays as it is.
    """
    observations = observe(log, nominal)
    kind = learning.residual if len(observations) else "none"
    return fit_residual(kind, observations, learning.features, learning.memory)


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
    observer: Observer = Observer(),
) -> list[Deployment]:
    """Runs the experiment, or goes on with one that was broken off, and keeps its record in `folder`.

    Writes `steps.csv` as steps happen, `models/iteration_K.json` before deployment K and `summary.json`
    after every deployment. No recorded step is lost: deployments that `summary.json` vouches for are
    taken as they are; what was recorded after them is replayed from its seed, which must give the
    same steps, and from there the experiment goes on.

    Args:
        nominal: Map of the physics model.
        make_plant: Makes the plant of one deployment from its random generator.
        reference: What to track.
        learning: How often is learnt, and what.
        folder: An existing folder.
        seed: Of all randomness; deployment K draws from `default_rng([seed, K])`.
        observer: Whom to tell.

    Raises:
        ValueError: The reference is not one for this map.
        RecordError: The folder's record is not one of this experiment, or another process is writing it.
    """
    reference.check(nominal.space)
    path, log, deployments = folder / "steps.csv", StepLog(nominal.space), []
    with StepWriter(path, nominal.space) as writer, threadpool_limits(limits=1, user_api="blas"):  # same bytes anywhere
        recorded = deque(writer.recorded)
        vouched = _vouched_deployments(folder / "summary.json", writer.recorded, seed)
        for iteration in range(learning.iterations + 1):
            residual = learn(nominal, log, learning)
            if iteration > 0:
                write_whole(folder / "models" / f"iteration_{iteration}.json", json.dumps(residual.to_dict()))
            if iteration < vouched:
                steps = _taken_as_recorded(recorded, iteration)
            else:
                plant = make_plant(np.random.default_rng([seed, iteration]))
                steps = deploy(CorrectedMap(nominal, residual), plant, reference, iteration, log)
                steps = _recorded_once(steps, recorded, writer, path)
            with closing(steps):  # so that an error here stops the plant at once
                for logged in steps:
                    log.append(logged)
                    observer.on_step(logged)
            deployments.append(summarise(log.of_iteration(iteration), reference, residual.name))
            if not recorded:
                write_whole(folder / "summary.json", json.dumps(_summary(deployments, log, reference, seed), indent=1))
            observer.on_deployment(deployments[-1])
            if not _worth_going_on(deployments, nominal.space.state_scale, learning.least_gain):
                break
    if recorded:
        raise RecordError(f"{path}: it has steps after the last deployment of this experiment; {SAME_AGAIN}")
    return deployments


def _vouched_deployments(path: Path, recorded: StepLog, seed: int) -> int:
    """How many whole deployments of the record are what they were when `summary.json` was written."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        count, wanted = len(summary["iterations"]), (summary["seed"], summary["steps_sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0  # none, or not ours: it will be written anew
    known = StepLog(recorded.space, (logged for logged in recorded if logged.iteration < count))
    return count if (seed, digest(known)) == wanted else 0


def _taken_as_recorded(recorded: deque[LoggedStep], iteration: int) -> Steps:
    """The recorded steps of a deployment."""
    while recorded and recorded[0].iteration == iteration:
        yield recorded.popleft()


def _recorded_once(steps: Steps, recorded: deque[LoggedStep], writer: StepWriter, path: Path) -> Steps:
    """The steps, each after it is on disk: those recorded already are compared, the others written."""
    with closing(steps):
        for logged in steps:
            if recorded:
                _check_same(path, recorded.popleft(), logged)
            else:
                writer.append(logged)
            yield logged


def _check_same(path: Path, known: LoggedStep, replayed: LoggedStep) -> None:
    """Raises RecordError unless the replayed step is the recorded one to the last bit."""
    if row_of(known) != row_of(replayed):
        raise RecordError(
            f"{path}: replaying deployment {replayed.iteration} gave another step {replayed.step} than the one "
            f"recorded; {SAME_AGAIN}"
        )


def _worth_going_on(deployments: Sequence[Deployment], scale: Array, least_gain: float) -> bool:
    """Whether the last deployment still made the tracking error smaller."""
    errors = [inf if deployment.falls else float(np.linalg.norm(deployment.rmse / scale)) for deployment in deployments]
    return len(errors) < 3 or errors[-1] == inf or errors[-1] <= (1 - least_gain) * min(errors[:-1])


def _summary(deployments: Sequence[Deployment], log: StepLog, reference: Reference, seed: int) -> dict[str, Any]:
    """The content of `summary.json`; NaN becomes null. Its digest vouches for `steps.csv` as it stood then."""
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
        "steps_sha256": digest(log),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in RECORDED_VERSIONS}},
    }
