"""One deployment: tracking a reference step by step with the map as known so far."""

from collections.abc import Callable, Generator, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Protocol, Self, final

import numpy as np
from numpy.typing import ArrayLike

from stepgap.base.errors import StepGapError
from stepgap.base.ranges import format_value
from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.command_table import CommandTable, build_table
from stepgap.control.following import Following
from stepgap.control.reach import reach_from
from stepgap.control.reference import Reference
from stepgap.control.settings import ALL_RULES, ControlSettings
from stepgap.experiment.exploration import exploration_plan, goals_of
from stepgap.learning.alarm import Alarm
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.interval_calibration import IntervalCalibration
from stepgap.learning.residual import Residual, join_points
from stepgap.learning.residual_check import check_prediction
from stepgap.learning.steps import LoggedStep
from stepgap.plants.plant import Plant, Touchdown
from stepgap.step import Array, StepFailed, StepMap, StepRecord, StepSpace, StepStatus

ExecutedSteps = Generator[LoggedStep, None, None]
"""Generator of steps as they are executed; closing it stops the plant."""


NO_PLAN = (
    "the search found no command that makes a step by the map, so the middle of the bounds was commanded; compare the "
    "state with its ranges of use, or raise control.evaluations"
)
"""What is said of a step whose plan has no prediction, without a full stop."""

MISSED = 0.1  # Part of half a range of use by which a plan misses a distance that may be out of reach


class AdaptiveMap(Protocol):
    """The map between two steps of a deployment, as far as it is known; a `Learner` is one."""

    @property
    def nominal(self) -> StepMap:
        """Map of the physics model."""
        ...

    @property
    def conditioned_residual(self) -> Residual:
        """Model of actual − nominal for the next step, a function of state and command."""
        ...

    @property
    def failures(self) -> Array:
        """Points (state, command) of the failed steps; shape (k, n + m)."""
        ...

    @property
    def farthest(self) -> Array:
        """Largest distance of a command from the state, in deployments before that did not fail; shape (m,)."""
        ...

    @property
    def alarms(self) -> tuple[Alarm, ...]:
        """What was found to be no longer true, in this deployment so far."""
        ...

    def step_map(self) -> StepMap:
        """Map for planning the next step."""
        ...

    def found(self, context: Mapping[str, float]) -> Self:
        """State of knowledge at the touchdown of the next step, with the context that it has found."""
        ...

    def after(self, logged: LoggedStep) -> Self:
        """State of knowledge after the executed step."""
        ...


@final
@dataclass(frozen=True, eq=False)
class DeploymentController:
    """The controller of a deployment between two steps; `start` makes the first one, `after` the next one.

    Attributes:
        learner: State of knowledge.
        settings: Settings of step control.
        following: How the robot followed its commands so far.
        table: Table of the commands of the first map, if the settings want one.
        command: Command of the step before, from which the search for the next one starts; None before the first.
        calibration: Calibration of the standard deviations of its plans; None before the first step.
    """

    learner: AdaptiveMap
    settings: ControlSettings
    following: Following
    table: CommandTable | None = None
    command: Array | None = None
    calibration: IntervalCalibration | None = None

    @classmethod
    def start(cls, learner: AdaptiveMap, settings: ControlSettings = ALL_RULES) -> Self:
        """Returns the controller before the first step.

        Args:
            learner: State of knowledge before the deployment.
            settings: Settings of step control.
        """
        table = build_table(learner.step_map(), settings.table) if settings.table else None
        space = learner.nominal.space
        farthest = learner.farthest if space.planar_seconds else None
        return cls(learner, settings, Following.start(space, settings, farthest), table)

    @property
    def step_controller(self) -> CautiousController:
        """Controller of the next step."""
        learner = self.learner
        maps = learner.step_map(), learner.nominal
        return CautiousController(*maps, learner.failures, self.settings, self.table, self.command)

    def plan(self, state: Array, target: Array, ahead: ArrayLike = ()) -> CautiousPlan:
        """Plans the next step; the middle of its bounds where the map has no command that makes a step.

        Args:
            state: Measured state; shape (n,).
            target: State wanted after the step; shape (n,).
            ahead: Targets of the steps after it, of which the first `horizon` − 1 are planned together with it;
                shape (k, n).

        Raises:
            ResidualError: The learned residual has no finite prediction of the step.
        """
        following = self.following
        later = np.asarray(ahead)[: self.settings.horizon - 1]
        target, *later = following.wanted(np.array([target, *later]))
        if (told := following.told(state, target)) is not None:
            return self.predicted_plan(state, told)
        controller = replace(self.step_controller, around=following.around(state))
        return self.calibrated(state, tracking_plan(controller, state, target, self.command, later))

    def calibrated(self, state: Array, plan: CautiousPlan) -> CautiousPlan:
        """Returns a plan of the next step with the calibrated standard deviation of its prediction."""
        if self.calibration is None or not plan.std.any():
            return plan
        share = _share_of_map(self.learner.step_map(), state, plan.command)
        return replace(plan, std=plan.std * self.calibration.factor(state, plan.predicted, share))

    def predicted_plan(self, state: Array, command: Array) -> CautiousPlan:
        """What the map predicts of a command that was not planned from this state."""
        controller = self.step_controller
        predicted = controller.step_map.evaluate(state, command).next_state
        return self.calibrated(state, CautiousPlan(command, predicted, controller.step_std(state, command)))

    def logged_first(self, iteration: int, number: int, record: StepRecord) -> LoggedStep:
        """The step that a robot took before the first planned one, without a target, with what the map predicts."""
        controller = self.step_controller
        point = (record.state, record.requested)
        predicted = controller.step_map.evaluate(*point).next_state
        nowhere = np.full_like(record.state, np.nan)
        return LoggedStep(iteration, number, nowhere, predicted, controller.step_std(*point), record)

    def after(self, logged: LoggedStep) -> Self:
        """Returns the controller after a step that was executed."""
        record = logged.record
        pose = np.array([record.context.get(name, np.nan) for name in StepSpace.pose_names])
        return replace(
            self,
            learner=self.learner.after(logged),
            command=record.command,
            calibration=self._calibration_after(logged),
            following=self.following.after(logged.target, logged.predicted, record.next_state, pose),
        )

    def _calibration_after(self, logged: LoggedStep) -> IntervalCalibration | None:
        record = logged.record
        has_std = logged.std > 0
        if not (has_std.any() and logged.planned):
            return self.calibration
        step_map = self.learner.step_map()
        calibration = self.calibration or IntervalCalibration.start(step_map.space)
        ratio = np.divide(
            record.next_state - logged.predicted, logged.std, out=np.full(len(has_std), np.nan), where=has_std
        )
        share = _share_of_map(step_map, record.state, record.command)
        return calibration.after(record.state, logged.predicted, share, ratio)


def deploy(
    learner: AdaptiveMap,
    plant: Plant,
    reference: Reference,
    iteration: int,
    exploration: int = 0,
    control: ControlSettings = ALL_RULES,
    on_time: Callable[[str, float], None] = lambda part, seconds: None,
    on_learner: Callable[[AdaptiveMap], None] = lambda learner: None,
    on_warning: Callable[[str], None] = lambda sentence: None,
) -> ExecutedSteps:
    """Tracks the reference until its end or a failed step, at each step with the map as known then.

    Args:
        learner: State of knowledge before the first step.
        plant: Executes the steps.
        reference: Reference to track from step 1 on.
        iteration: Number of the deployment.
        exploration: Number of exploratory steps before step 1, which are numbered up to 0. The plant's `first_step`
            comes before them, with number −`exploration`.
        control: Settings of step control.
        on_time: Called with "planning" or "learning", and how long that took for one step [s].
        on_learner: Called with the state of knowledge after each step.
        on_warning: Called before a step whose target is a distance that no command reaches, and before the first one
            for which no command is found.

    Raises:
        StepGapError: The first state of the plant is not finite, or has another shape.
        ResidualError: The learned residual failed, or has no finite prediction of a step.
    """
    controller = DeploymentController.start(learner, control)
    lost = False  # whether a step had no plan
    with plant:
        state = _checked_start(plant.start(), plant.space)
        if record := plant.first_step:
            logged = controller.logged_first(iteration, -exploration, record)
            yield logged
            controller = controller.after(logged)
        for number in range(1 - exploration, len(reference) + 1):
            begin = perf_counter()
            if number < 1:
                plan = _explored(controller, reference, state)
            else:
                target = reference.targets[number - 1]
                plan = controller.plan(plant.space.onward(state), target, reference.targets[number:])
            on_time("planning", perf_counter() - begin)
            if not (lost or np.isfinite(plan.predicted).all()):
                lost = True
                on_warning(f"step {number}: {NO_PLAN}")
            replan = partial(_replanned, reference, number, plan, on_time, on_warning)
            record, plan = _taken(plant, controller, plan, replan)
            target = asked(reference, number, plant.space, record.context) if number > 0 else plan.predicted
            logged = LoggedStep(iteration, number, target, plan.predicted, plan.std, record)
            yield logged
            if record.status != StepStatus.OK:
                return
            begin = perf_counter()
            controller = controller.after(logged)
            state = record.next_state
            on_time("learning", perf_counter() - begin)
            on_learner(controller.learner)


def _replanned(
    reference: Reference,
    number: int,
    plan: CautiousPlan,
    on_time: Callable[[str, float], None],
    on_warning: Callable[[str], None],
    controller: DeploymentController,
    touchdown: Touchdown,
) -> CautiousPlan:
    """Plan of a step at its touchdown; an exploratory one keeps its command."""
    if number < 1:
        return controller.predicted_plan(touchdown.state, plan.command)
    begin = perf_counter()
    step_map = controller.learner.step_map()
    target = asked(reference, number, step_map.space, touchdown.context)
    plan = controller.plan(touchdown.state, target, reference.targets[number:])
    on_time("planning", perf_counter() - begin)
    for sentence in beyond_reach(step_map, touchdown, target, plan):
        on_warning(f"step {number}: {sentence}")
    return plan


def asked(reference: Reference, number: int, space: StepSpace, context: Mapping[str, float]) -> Array:
    """Target of a step; of a distance whose targets add up, from where the step stands, if that is known; shape (n,).

    Args:
        reference: Its targets are distances from where the step before should have ended.
        number: Number of the step, from 1.
        space: Names of the context, and which coordinates add up.
        context: What the touchdown of the step has found.
    """
    target = reference.targets[number - 1]
    if not space.adds_up.any():
        return target
    stands = np.array([context.get(quantity.above, np.nan) for quantity in space.state])
    behind = np.where(space.adds_up, reference.targets[: number - 1].sum(axis=0) - stands, 0.0)
    return target + np.nan_to_num(behind)


def beyond_reach(step_map: StepMap, touchdown: Touchdown, target: Array, plan: CautiousPlan) -> Iterator[str]:
    """Sentences on distances that no command reaches, such as that to the next foothold.

    Args:
        step_map: The map.
        touchdown: Where the step starts.
        target: Its target; shape (n,).
        plan: Its plan, beside which only a target is looked at that it misses.
    """
    space = step_map.space
    missed = space.adds_up & space.has_target(target)
    missed &= np.abs(np.nan_to_num(target) - plan.predicted) > MISSED * space.state_scale
    if not missed.any():
        return
    least, most = reach_from(step_map, touchdown.state)
    for number in np.flatnonzero(missed & ~((least <= target) & (target <= most))):
        quantity = space.state[number]
        distance = target[number]
        yield (
            f"the next {quantity.above}, at {touchdown.context[quantity.above] + distance:.3f} {quantity.unit}, is "
            f"{distance:.3f} {quantity.unit} away, but commands reach {least[number]:.3f} to {most[number]:.3f} "
            f"{quantity.unit}"
        )


def _taken(
    plant: Plant,
    controller: DeploymentController,
    plan: CautiousPlan,
    replan: Callable[[DeploymentController, Touchdown], CautiousPlan],
) -> tuple[StepRecord, CautiousPlan]:
    """A step as it was taken, and the plan of the command that acted, from the state that was found.

    Where states are measured above what a foot finds, the command is planned again at touchdown.

    Args:
        plant: Takes the step.
        controller: What is known before it.
        plan: Plan from the state as it is known before.
        replan: Plans the step again.
    """
    if not plant.space.is_above_context:
        return plant.take_step(plan.command), plan
    plans = [plan]

    def at_touchdown(touchdown: Touchdown) -> Array:
        knowing = replace(controller, learner=controller.learner.found(touchdown.context))
        plans.append(replan(knowing, touchdown))
        return plans[-1].command

    record = plant.take_replanned_step(plan.command, at_touchdown)
    if len(plans) > 1 and np.array_equal(plans[-1].command, record.command):
        return record, plans[-1]
    knowing = replace(controller, learner=controller.learner.found(record.context))
    return record, knowing.predicted_plan(record.state, record.command)


def _explored(controller: DeploymentController, reference: Reference, state: Array) -> CautiousPlan:
    step_controller = controller.step_controller
    goals = goals_of(reference, step_controller.step_map)
    plan = exploration_plan(step_controller, controller.learner.conditioned_residual, state, goals)
    return controller.calibrated(state, _checked(step_controller.step_map, state, plan))


def _share_of_map(step_map: StepMap, state: Array, command: Array) -> Array:
    """Part of the variance of a measured step that is due to the map and not noise, from 0 to 1; shape (n,)."""
    std = step_map.std(state, command)
    noise_std = step_map.noise_std
    return np.divide(std**2, std**2 + noise_std**2, out=np.zeros(len(std)), where=std > 0)


def _checked_start(state: Array, space: StepSpace) -> Array:
    """Returns the first state of a plant; raises StepGapError unless it is one finite number for each coordinate."""
    expected = (len(space.state),)
    if np.shape(state) != expected or not np.isfinite(state).all():
        raise StepGapError(
            f"the first state of the plant is {format_value(state)}, but it must be finite numbers of shape {expected}"
        )
    return state


def tracking_plan(
    controller: CautiousController, state: Array, target: Array, guess: Array | None, ahead: ArrayLike = ()
) -> CautiousPlan:
    """The command for a target; the middle of its bounds where the map has no command that makes a step.

    Raises:
        ResidualError: The residual that corrects the map has no finite prediction of the step.
    """
    try:
        plan = controller(state, target, guess, ahead)
    except StepFailed:
        bounds = controller.bounds
        command = np.clip(controller.step_map.space.command_centre, bounds.command_lower, bounds.command_upper)
        plan = CautiousPlan(command, np.full_like(target, np.nan), controller.step_std(state, command))
    return _checked(controller.step_map, state, plan)


def _checked(step_map: StepMap, state: Array, plan: CautiousPlan) -> CautiousPlan:
    """Returns a plan; raises ResidualError if it lacks a prediction because the residual of the map has none."""
    predicted = np.isfinite([plan.predicted, plan.std]).all()
    if not predicted and np.isfinite(state).all() and isinstance(step_map, CorrectedMap):
        residual = step_map.residual
        point = join_points(state, plan.command)
        check_prediction(residual.kind, residual.mean(point), residual.std(point))
    return plan
