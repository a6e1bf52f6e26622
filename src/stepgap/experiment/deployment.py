"""One deployment: tracking a reference step by step with the map as known so far, and the tracking errors."""

from collections.abc import Generator
from typing import Protocol, Self

import numpy as np

from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.reference import Reference
from stepgap.experiment.exploration import exploration_plan, goals_of
from stepgap.learning.background import BackgroundThread, Deferred
from stepgap.learning.residual import Residual
from stepgap.learning.step_log import LoggedStep, StepLog
from stepgap.plants.plant import Plant
from stepgap.records.summary import Deployment
from stepgap.step import Array, StepFailed, StepMap, StepStatus

Steps = Generator[LoggedStep, None, None]
"""Generator of steps as they are executed; closing it stops the plant."""


def summarise(steps: StepLog, reference: Reference, residual: str) -> Deployment:
    """Tracking errors of the steps of one deployment."""
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
    """Noise floor estimated from the steady steps of one deployment [state units]; shape (n,).

    It is the residual standard error of a linear fit of the next state in state and command. Where the map is not
    linear, it is larger than the true noise. NaN where the steps are too few.
    """
    numbers = set((reference.steady + 1).tolist())
    steady = StepLog(steps.space, (logged for logged in steps.completed() if logged.step in numbers))
    inputs = np.hstack([np.ones((len(steady), 1)), steady.state, steady.requested])
    degrees_of_freedom = len(steady) - inputs.shape[1]
    if degrees_of_freedom < 1:
        return np.full(len(steps.space.state), np.nan)
    fitted = inputs @ np.linalg.lstsq(inputs, steady.next_state, rcond=None)[0]
    return np.sqrt(np.sum((steady.next_state - fitted) ** 2, axis=0) / degrees_of_freedom)


class AdaptiveMap(Protocol):
    """The map between two steps of a deployment, as far as it is known; a `Learner` is one."""

    @property
    def nominal(self) -> StepMap:
        """Map of the physics model."""
        ...

    @property
    def residual(self) -> Residual:
        """Model of actual − nominal for the next step."""
        ...

    @property
    def failures(self) -> Array:
        """Points (state, command) of the failed steps; shape (k, n + m)."""
        ...

    @property
    def pending(self) -> Deferred[Residual] | None:
        """Computation that a thread may do while the robot hops."""
        ...

    def step_map(self) -> StepMap:
        """Map for planning the next step."""
        ...

    def after(self, logged: LoggedStep) -> Self:
        """State of knowledge after the executed step."""
        ...


def deploy(learner: AdaptiveMap, plant: Plant, reference: Reference, iteration: int, exploration: int = 0) -> Steps:
    """Tracks the reference until its end or a fall, at each step with the map as known then.

    Args:
        learner: State of knowledge before the first step.
        plant: Executes the steps.
        reference: Reference to track from step 1 on.
        iteration: Number of the deployment.
        exploration: Number of exploratory steps before step 1, which are numbered up to 0.
    """
    command = None
    with BackgroundThread() as background, plant:
        state = plant.start()
        for number in range(1 - exploration, len(reference) + 1):
            controller = CautiousController(learner.step_map(), learner.nominal, learner.failures)
            if number < 1:
                goals = goals_of(reference, controller.step_map)
                plan = exploration_plan(controller, learner.residual, state, goals)
            else:
                plan = tracking_plan(controller, state, reference.targets[number - 1], command)
            background.compute(learner.pending)  # after the command, so that it causes no delay
            record = plant.take_step(plan.command)
            target = reference.targets[number - 1] if number > 0 else plan.predicted
            logged = LoggedStep(iteration, number, target, plan.predicted, plan.std, record)
            yield logged
            if record.status != StepStatus.OK:
                return
            learner = learner.after(logged)
            state, command = record.next_state, plan.command


def tracking_plan(controller: CautiousController, state: Array, target: Array, guess: Array | None) -> CautiousPlan:
    """The command for a target; the middle of the bounds where the map has no command that makes a step."""
    try:
        return controller(state, target, guess=guess)
    except StepFailed:
        command = controller.step_map.space.command_centre
        return CautiousPlan(command, np.full_like(target, np.nan), controller.step_std(state, command))
