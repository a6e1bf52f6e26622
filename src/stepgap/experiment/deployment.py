"""One deployment: track a reference with what is known of the map, step by step, and measure how well."""

from collections.abc import Generator
from typing import Protocol, Self

import numpy as np

from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.reference import Reference
from stepgap.experiment.exploration import calibrating_plan, goals_of
from stepgap.learning.background import BackgroundThread, Deferred
from stepgap.learning.residual import Residual
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.plants.plant import Plant
from stepgap.records.summary import Deployment
from stepgap.step import Array, StepFailed, StepMap, StepStatus

Steps = Generator[LoggedStep, None, None]
"""Steps as they are executed; closing it stops the plant."""


def summarise(steps: StepLog, reference: Reference, residual: str) -> Deployment:
    """The errors of one deployment's steps."""
    tracked = StepLog(steps.space, (logged for logged in steps.completed() if logged.step > 0))
    numbers = np.array([logged.step - 1 for logged in tracked], dtype=int)
    error = tracked.next_state - tracked.target

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


def estimate_noise_floor(steps: StepLog, reference: Reference) -> Array:
    """Standard deviation of the next state at equal state and command, from steady steps [state units]; shape (n,).

    Estimated from one deployment: the residual standard error of the next state after a linear fit in state and
    command. Where the map bends, that is more than the true noise. NaN where the steps are too few.
    """
    numbers = set((reference.steady + 1).tolist())
    steady = StepLog(steps.space, (logged for logged in steps.completed() if logged.step in numbers))
    inputs = np.hstack([np.ones((len(steady), 1)), steady.state, steady.applied])
    degrees_of_freedom = len(steady) - inputs.shape[1]
    if degrees_of_freedom < 1:
        return np.full(len(steps.space.state), np.nan)
    fitted = inputs @ np.linalg.lstsq(inputs, steady.next_state, rcond=None)[0]
    return np.sqrt(np.sum((steady.next_state - fitted) ** 2, axis=0) / degrees_of_freedom)


class AdaptiveMap(Protocol):
    """What a deployment needs to know of the map between two steps; a `Learner` is one."""

    @property
    def nominal(self) -> StepMap:
        """Map of the physics model."""
        ...

    @property
    def residual(self) -> Residual:
        """Model of actual − nominal for the step to come."""
        ...

    @property
    def failures(self) -> Array:
        """Points (state, command) of the steps that failed; shape (k, n + m)."""
        ...

    @property
    def pending(self) -> Deferred[Residual] | None:
        """What a thread may compute while the robot hops."""
        ...

    def step_map(self) -> StepMap:
        """The map to plan the next step with."""
        ...

    def after(self, logged: LoggedStep) -> Self:
        """The map after the step just executed."""
        ...


def deploy(learner: AdaptiveMap, plant: Plant, reference: Reference, iteration: int, exploration: int = 0) -> Steps:
    """Tracks the reference with the map as it is known at each step, until its end or a fall.

    Args:
        learner: What is known before the first step.
        plant: Executes the steps.
        reference: What to track, from step 1 on.
        iteration: Number of the deployment.
        exploration: Steps before that, numbered up to 0, whose commands are chosen for what they teach.
    """
    command = None
    with BackgroundThread() as background, plant:
        state = plant.start()
        for number in range(1 - exploration, len(reference) + 1):
            controller = CautiousController(learner.step_map(), learner.nominal, learner.failures)
            if number < 1:
                goals = goals_of(reference, controller.step_map)
                plan = calibrating_plan(controller, learner.residual, state, goals)
            else:
                plan = tracking_plan(controller, state, reference.targets[number - 1], command)
            background.compute(learner.pending)  # now that the command is out, so that it delays none
            record = plant.take_step(plan.command)
            target = reference.targets[number - 1] if number > 0 else plan.predicted
            logged = LoggedStep(iteration, number, target, plan.predicted, plan.std, record)
            yield logged
            if record.status != StepStatus.OK:
                return
            learner = learner.after(logged)
            state, command = record.next_state, plan.command


def tracking_plan(controller: CautiousController, state: Array, target: Array, guess: Array | None) -> CautiousPlan:
    """The command for a target; the middle of the bounds where the map knows none that makes a step."""
    try:
        return controller(state, target, guess=guess)
    except StepFailed:
        command = controller.step_map.space.command_centre
        return CautiousPlan(command, np.full_like(target, np.nan), controller.step_std(state, command))
