"""The whole method (Sec. 4.4): deploy, learn the map's error, recompute the controller, deploy again.

It knows no robot: a nominal `StepMap`, something that makes a `Plant`, and a `Reference` are all it takes.
"""

import json
import platform
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from stepgap.base.files import write_whole
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import Deployment, Steps, deploy, summarise
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.plants.plant import Plant
from stepgap.records.model_files import write_model
from stepgap.records.steps_csv import RecordError, StepWriter, digest, row_of
from stepgap.step import Array, StepMap

SCHEMA = 1
"""Version of `summary.json`."""

MEASURES = ("rmse", "mae", "bias", "steady_rmse", "transient_rmse")
"""Tracking errors of a deployment in `summary.json`."""

RECORDED_VERSIONS = ("stepgap", "numpy", "scipy", "numba", "mujoco")
"""Packages whose versions `summary.json` names: with others the same seed may give other last digits."""

SAME_AGAIN = "resume with the record, settings, versions and machine that it was started with"
"""What to do when a replay does not give the recorded steps."""


MeasureSpread = Callable[[StepMap, np.random.Generator], Array]
"""Measures the repeatability of a plant under the step controller of a map; shape (n,)."""


def versions_here() -> dict[str, str]:
    """Version of each recorded package, by its name."""
    return {"python": platform.python_version(), **{name: version(name) for name in RECORDED_VERSIONS}}


def deployment_generator(seed: int, iteration: int) -> np.random.Generator:
    """What the plant of a deployment draws from."""
    return random_stream(seed, iteration)


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


@dataclass(frozen=True)
class Observer:
    """Whom to tell of progress; both may take their time.

    Attributes:
        on_step: Told of every executed step, after it is on disk.
        on_deployment: Told of every finished deployment.
        on_fault: Told what the plant had to say of a deployment that ended before its time.
    """

    on_step: Callable[[LoggedStep], None] = lambda logged: None
    on_deployment: Callable[[Deployment], None] = lambda deployment: None
    on_fault: Callable[[str], None] = lambda words: None


def run(
    nominal: StepMap,
    make_plant: Callable[[np.random.Generator], Plant],
    reference: Reference,
    learning: LearningSettings,
    folder: Path,
    seed: int,
    observer: Observer = Observer(),
    measure_spread: MeasureSpread | None = None,
    replays: bool = True,
    known: StepLog | None = None,
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
        seed: Of all randomness; deployment K draws from `deployment_generator(seed, K)`.
        observer: Whom to tell.
        measure_spread: Measures the repeatability under the last controller; drawing from `random_stream(seed, K, 1)`
            after deployment K. Without it, it is estimated from the steady steps.
        replays: Plants made from the same generator take the same steps again. Where they do not, as on hardware, the
            steps of a deployment that was broken off stay as they are, and the next deployment starts.
        known: Steps of the same state and command, recorded earlier, that are learnt from before the first deployment;
            where they are those of another robot or map, the errors of this nominal map are what is learnt.

    Raises:
        ValueError: The reference is not one for this map.
        RecordError: The folder's record is not one of this experiment, or another process is writing it.
    """
    reference.check(nominal.space)
    path, log, deployments, learner = folder / "steps.csv", StepLog(nominal.space), [], None
    past = _as_past(known or StepLog(nominal.space))
    with StepWriter(path, nominal.space) as writer, threadpool_limits(limits=1, user_api="blas"):  # same bytes anywhere
        recorded = deque(writer.recorded)
        former = _read_summary(folder / "summary.json")
        vouched = _vouched_deployments(former, writer.recorded, seed, past)
        for iteration in range(learning.iterations + 1):
            learner = Learner(nominal, StepLog(nominal.space, [*past, *log]), learning, iteration)
            if iteration > 0 or len(past):
                write_model(folder, iteration, learner.residual)
            kept, plant = not replays and bool(recorded) and recorded[0].iteration == iteration, None
            if iteration < vouched or kept:
                steps = _taken_as_recorded(recorded, iteration)
            else:
                plant = make_plant(deployment_generator(seed, iteration))
                steps = deploy(learner, plant, reference, iteration, 0 if iteration else learning.calibration)
                steps = _recorded_once(steps, recorded, writer, path)
            with closing(steps):  # so that an error here stops the plant at once
                for logged in steps:
                    log.append(logged)
                    observer.on_step(logged)
            if plant and plant.fault:
                observer.on_fault(plant.fault)
            kind = learning.residual if learning.lessons(iteration) else learner.residual.name
            deployments.append(summarise(log.of_iteration(iteration), reference, kind))
            if not recorded:
                write_whole(
                    folder / "summary.json", json.dumps(_summary(deployments, log, reference, seed, past), indent=1)
                )
            observer.on_deployment(deployments[-1])
            if not _worth_going_on(deployments, nominal.space.state_scale, learning.least_gain):
                break
        if measure_spread and learner and not recorded:
            spread = _measured_spread(former, nominal.space.state_names) if vouched == len(deployments) else None
            if spread is None:
                spread = measure_spread(learner.step_map(), random_stream(seed, deployments[-1].iteration, 1))
            summary = _summary(deployments, log, reference, seed, past, spread)
            write_whole(folder / "summary.json", json.dumps(summary, indent=1))
    if recorded:
        raise RecordError(f"{path}: it has steps after the last deployment of this experiment; {SAME_AGAIN}")
    return deployments


def _read_summary(path: Path) -> Any:
    """What `summary.json` holds; nothing if there is none."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return None


def _as_past(known: StepLog) -> StepLog:
    """The steps as those of deployments before number 0."""
    count = max(known.iterations, default=-1) + 1
    return StepLog(known.space, (replace(logged, iteration=logged.iteration - count) for logged in known))


def _warm_start(past: StepLog) -> dict[str, Any]:
    """What `summary.json` says of the steps known before; nothing where there were none."""
    return {"warm_start": {"steps": len(past), "steps_sha256": digest(past)}} if len(past) else {}


def _vouched_deployments(summary: Any, recorded: StepLog, seed: int, past: StepLog) -> int:
    """How many whole deployments of the record are what they were when `summary.json` was written."""
    try:
        count, wanted = len(summary["iterations"]), (summary["seed"], summary["steps_sha256"])
    except (KeyError, TypeError):
        return 0  # none, or not ours: it will be written anew
    done = StepLog(recorded.space, (logged for logged in recorded if logged.iteration < count))
    if _warm_start(past).get("warm_start") != summary.get("warm_start"):
        return 0
    return count if (seed, digest(done)) == wanted else 0


def _measured_spread(summary: Any, names: Sequence[str]) -> Array | None:
    """The repeatability that `summary.json` holds, if it was measured."""
    try:
        known = [summary["repeatability"][name] for name in names]
        return np.array(known, float) if summary["repeatability_measured"] is True else None
    except (ValueError, KeyError, TypeError):
        return None


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


def _summary(
    deployments: Sequence[Deployment],
    log: StepLog,
    reference: Reference,
    seed: int,
    past: StepLog,
    measured: Array | None = None,
) -> dict[str, Any]:
    """The content of `summary.json`; NaN becomes null. Its digest vouches for `steps.csv` as it stood then."""
    last = log.of_iteration(deployments[-1].iteration)
    names = log.space.state_names
    return {
        "schema": SCHEMA,
        "seed": seed,
        "iterations": [summary_entry(deployment, names) for deployment in deployments],
        "repeatability": _named(names, repeatability(last, reference) if measured is None else measured),
        "repeatability_measured": measured is not None,
        "steps_sha256": digest(log),
        **_warm_start(past),
        "versions": versions_here(),
    }


def summary_entry(deployment: Deployment, names: Sequence[str]) -> dict[str, Any]:
    """What `summary.json` says of a deployment; `names` are those of the state. NaN becomes null."""
    return {
        "iteration": deployment.iteration,
        "residual": deployment.residual,
        "steps": deployment.steps,
        "falls": deployment.falls,
        **{measure: _named(names, getattr(deployment, measure)) for measure in MEASURES},
    }


def _named(names: Sequence[str], values: Array) -> dict[str, float | None]:
    return {name: float(value) if np.isfinite(value) else None for name, value in zip(names, values, strict=True)}
