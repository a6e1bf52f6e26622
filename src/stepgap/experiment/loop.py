"""The experiment loop (Sec. 4.4 of the paper): deploy, learn the map's error, recompute the controller, deploy again.

It does not depend on a robot: a `Setup` needs only a nominal `StepMap`, `Plants`, and a `Reference`.
"""

from collections import deque
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial, reduce
from math import inf
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import numpy as np

from stepgap.base.blas import one_blas_thread
from stepgap.base.random_streams import random_stream
from stepgap.base.versions import versions_here
from stepgap.control.reference import Reference
from stepgap.control.settings import ALL_RULES, ControlSettings
from stepgap.experiment.deployment import AdaptiveMap, DeploymentController, ExecutedSteps, deploy
from stepgap.experiment.exploration import worth_of_steps, worthwhile
from stepgap.experiment.outcome import estimate_noise_floor, summarise
from stepgap.experiment.resume import Recording, warm_start_of
from stepgap.learning.alarm import Alarm
from stepgap.learning.learner import Learner
from stepgap.learning.posterior import POSTERIOR
from stepgap.learning.prior import Prior
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps, as_past
from stepgap.plants.plant import Plant
from stepgap.records.steps_csv import digest
from stepgap.records.summary import Deployment, NoiseFloor, Summary
from stepgap.step import Array, StepMap, StepSpace

MeasureNoiseFloor = Callable[[StepMap, np.random.Generator, Callable[[int, int], None]], NoiseFloor]
"""Measures the noise floor of a plant under the step controller of a map, and reports its progress (done, total)."""


OnTime = Callable[[int, str, float], None]
"""Called with the deployment for which something was computed, what it was, and how long that took [s]."""


def deployment_generator(seed: int, iteration: int) -> np.random.Generator:
    """Random generator of the plant of a deployment."""
    return random_stream(seed, iteration)


@dataclass(frozen=True)
class Observer:
    """Progress callbacks, which may be slow.

    Attributes:
        on_step: Called with every executed step, after it is on disk.
        on_deployment: Called with every finished deployment.
        on_fault: Called with the plant's message about a deployment that was aborted.
        on_phase: Called with the name of what is done between deployments, and its progress (done, total); the total is
            0 where it is not known.
        on_alarm: Called when a step of a deployment that is executed shows that the robot is not what was learned.
        on_execution: Called before a deployment is executed, which is not done where its steps are taken from the
            record; then the record is locked, and agrees with the settings up to this deployment.
        on_time: Called with the number of a deployment, what was computed for it, and how long that took [s]: the `fit`
            before it, the `planning` of each command, and `learning` from each step.
        on_warning: Called with a sentence before a step whose target is a distance that no command reaches, and before
            the first one of a deployment for which the search found no command.
        on_exploration: Called with what each exploratory step is expected to be worth [`worth_of_steps`], where a prior
            says that; the last one is not made if it is worth too little.
    """

    on_step: Callable[[LoggedStep], None] = lambda logged: None
    on_deployment: Callable[[Deployment], None] = lambda deployment: None
    on_fault: Callable[[str], None] = lambda message: None
    on_phase: Callable[[str, int, int], None] = lambda name, done, total: None
    on_alarm: Callable[[Alarm], None] = lambda alarm: None
    on_execution: Callable[[], None] = lambda: None
    on_time: OnTime = lambda iteration, part, seconds: None
    on_warning: Callable[[str], None] = lambda sentence: None
    on_exploration: Callable[[Sequence[float]], None] = lambda worths: None


class Plants(NamedTuple):
    """Functions that make and measure the plants of a run.

    Attributes:
        make: Makes the plant of one deployment from its random generator.
        replays: Whether plants made from the same generator take the same steps again: then an interrupted deployment
            begins again. If not, as on hardware, its steps are kept, and the next deployment starts.
        measure_noise_floor: Measures the noise floor; None where that is not possible: then it is estimated from steady
            steps.
    """

    make: Callable[[np.random.Generator], Plant]
    replays: bool = True
    measure_noise_floor: MeasureNoiseFloor | None = None


@dataclass(frozen=True, eq=False)
class Setup:
    """What an experiment runs.

    Attributes:
        nominal: Map of the physics model.
        plants: Makes the plants; that of deployment K draws from `deployment_generator(seed, K)`, and the measurement
            of the noise floor after it from `random_stream(seed, K, 1)`.
        reference: Reference to track.
        learning: Settings of learning.
        control: Settings of step control.
        seed: Random seed.
        known: Steps with the same state and command, recorded earlier, that are used for learning before the first
            deployment; even if they come from another robot or map, the errors of this nominal map are learned.
        priors: Priors over robots with which learning begins.
    """

    nominal: StepMap
    plants: Plants
    reference: Reference
    learning: LearningSettings = LearningSettings()
    control: ControlSettings = ALL_RULES
    seed: int = 0
    known: Steps | None = None
    priors: Sequence[Prior] = ()


def run_experiment(setup: Setup, folder: Path, observer: Observer = Observer()) -> list[Deployment]:
    """Runs the experiment, or resumes one that was interrupted, and keeps its record in `folder`.

    Writes `steps.csv` as steps happen, `models/iteration_K.json` before deployment K (before 0 only if it is not the
    nominal map that plans it), and `summary.json` after every deployment; `experiment.resume` describes how a run is
    resumed.

    Args:
        folder: An existing folder.

    Raises:
        ValueError: The reference does not fit this map.
        RecordError: The record in the folder belongs to another experiment, another process is writing it, or a step
            cannot be recorded.
    """
    seed = setup.seed
    space = setup.nominal.space
    reference = setup.reference.of(space)
    setup = replace(setup, reference=reference)
    past = as_past(setup.known or Steps(space))
    deployments = list[Deployment]()
    with one_blas_thread(), Recording(folder, space, seed, past, setup.plants.replays) as recording:
        log = Steps(recording.space)
        prepare = partial(Learner.start, setup.nominal, Steps(recording.space) + past, setup.learning, 0, setup.priors)
        while True:
            # Learn from all steps so far.
            iteration = len(deployments)
            observer.on_phase("learning", 0, 0)
            begin = perf_counter()
            learner = prepare()
            seconds = perf_counter() - begin
            if iteration > 0 or len(past) or learner.beliefs:
                observer.on_time(iteration, "fit", seconds)
                recording.write_model(learner)
            # Deploy, or take the steps that are recorded.
            latest = deque[AdaptiveMap]([learner], maxlen=1)
            execute = partial(_execute, learner, setup, observer, partial(_follow, latest, observer))
            steps = _observed(recording.steps(iteration, execute), recording.space, observer)
            log += steps
            # Judge the deployment.
            final = _final(learner, latest[0], steps)
            floor = estimate_noise_floor(steps, reference)
            deployment = recording.deployment(iteration)
            if deployment is None:
                residual = _residual_name(learner)
                deployment = summarise(steps, reference, residual, learner.step_map(), floor.any_phase, final.alarms)
            deployments.append(deployment)
            summary = _summary(deployments, log, floor, seed, past)
            recording.write_summary(summary)
            observer.on_deployment(deployment)
            if is_finished(deployments, space.error_scale, setup.learning):
                break
            prepare = partial(final.redeployed, Steps(recording.space) + past + log, setup.priors)
        recording.check_finished()
        # Measure how well a controller could track.
        if measure := setup.plants.measure_noise_floor:
            noise_floor = recording.measured_noise_floor(len(deployments))
            if noise_floor is None:
                progress = partial(observer.on_phase, "measuring the noise floor")
                noise_floor = measure(final.step_map(), random_stream(seed, iteration, 1), progress)
            recording.write_summary(replace(summary, noise_floor=noise_floor, noise_floor_measured=True))
    return deployments


def _execute(
    learner: Learner, setup: Setup, observer: Observer, on_learner: Callable[[AdaptiveMap], None]
) -> ExecutedSteps:
    """Executes a deployment on a new plant, whose fault is reported at the end."""
    iteration = learner.iteration
    observer.on_execution()
    exploration = 0 if iteration else setup.learning.exploration
    if exploration and setup.priors and learner.beliefs:
        controller = DeploymentController.start(learner, replace(setup.control, table=0)).step_controller
        worths = worth_of_steps(controller, learner.conditioned_residual, setup.reference, exploration)
        observer.on_exploration(worths)
        exploration = worthwhile(worths)
    plant = setup.plants.make(deployment_generator(setup.seed, iteration))
    on_time = partial(observer.on_time, iteration)
    on_warning = observer.on_warning
    yield from deploy(
        learner, plant, setup.reference, iteration, exploration, setup.control, on_time, on_learner, on_warning
    )
    if plant.fault:
        observer.on_fault(plant.fault)


def _follow(latest: deque[AdaptiveMap], observer: Observer, learner: AdaptiveMap) -> None:
    """Reports the alarms of a learner that the latest one did not have, and puts it in its place."""
    for alarm in learner.alarms[len(latest[0].alarms) :]:
        observer.on_alarm(alarm)
    latest.append(learner)


def _final(first: Learner, latest: AdaptiveMap, steps: Steps) -> Learner:
    """The learner after a deployment; after one that was not executed here, it is found from the recorded steps.

    Args:
        first: The learner before it.
        latest: The latest one while it was executed.
        steps: All steps of it.
    """
    if isinstance(latest, Learner) and latest is not first:
        return latest
    return reduce(Learner.after, steps.completed(), first)


def _observed(steps: ExecutedSteps, space: StepSpace, observer: Observer) -> Steps:
    """All steps of a deployment, each reported when it happens; an error stops the plant immediately."""

    def reported() -> ExecutedSteps:
        for logged in steps:
            observer.on_step(logged)
            yield logged

    with closing(steps):
        return Steps(space, reported())


def _residual_name(learner: Learner) -> str:
    """Name of the residual of a deployment; one that learns while it goes on may start without a residual."""
    if not learner.settings.learns_in(learner.iteration):
        return learner.learned.kind
    alone = learner.beliefs and learner.residual.kind == "none"
    return POSTERIOR.name if alone else learner.settings.residual


def _summary(deployments: Sequence[Deployment], log: Steps, noise_floor: NoiseFloor, seed: int, past: Steps) -> Summary:
    """Summary of the finished deployments; its digest verifies `steps.csv` when the run is resumed."""
    return Summary(
        seed,
        tuple(deployments),
        noise_floor,
        versions=tuple(versions_here().items()),
        steps_sha256=digest(log),
        warm_start=warm_start_of(past),
    )


def is_finished(deployments: Sequence[Deployment], scale: Array, learning: LearningSettings) -> bool:
    """Whether a run makes no further deployment.

    Args:
        deployments: The finished ones.
        scale: Error of each state coordinate that counts as one (`StepSpace.error_scale`); shape (n,).
    """
    if len(deployments) > learning.iterations:  # beside the redeployments there is deployment 0
        return True
    return learning.early_stop and not _still_improves(deployments, scale, learning.tolerance)


def _still_improves(deployments: Sequence[Deployment], scale: Array, tolerance: float) -> bool:
    """Whether to deploy again: fewer than three deployments, the last one failed later, or an error still falling."""
    errors = [
        inf if deployment.failed_steps else float(np.linalg.norm(np.nan_to_num(deployment.rmse / scale)))
        for deployment in deployments
    ]
    if len(errors) < 3:
        return True
    if errors[-1] == inf:
        return not fails_no_later(deployments)
    return errors[-1] <= (1 - tolerance) * min(errors[:-1])


def fails_no_later(deployments: Sequence[Deployment]) -> bool:
    """Whether the last three deployments failed, the last of them after no more steps than one of the two before."""
    latest = deployments[-3:]
    steps = [deployment.steps for deployment in latest]
    return len(latest) == 3 and all(deployment.failed_steps for deployment in latest) and steps[-1] <= max(steps[:-1])
