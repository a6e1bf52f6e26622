"""Learning the error of the command instead of that of the state, as in feedback-error learning.

The nominal map has an inverse: the command u(x, y) with which the robot of the model hops from state x to state y. The
robot itself hopped from x to y with another command; the difference is learned as a function of x and y, and is added
to the inverse at the target.

`InverseMap` is the inverse as a `StepMap` whose command is y and whose next state is the command, in units of the
state. So a `Learner` learns the command's error as it learns any error. Only the deployment has an own loop, because a
command is computed directly, and not found by a controller on a map. The controller's cautious rules need a prediction
of the next state, and do not apply.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import final

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.learning.trial import Trial
from stepgap.control.cautious_controller import CautiousController
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.experiment.deployment import ExecutedSteps, tracking_plan
from stepgap.learning.learner import Learner
from stepgap.learning.settings import LearningSettings
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.plant import Plant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import CommandBounds
from stepgap.step import Array, Outcome, StepFailed, StepMap, StepRecord, StepSpace, StepStatus, difference_jacobian

WIDER = 2.0
"""Factor of the command bounds within which the model's command is sought: the robot's own may lie at its bounds."""


@final
@dataclass(frozen=True, eq=False)
class InverseMap(StepMap):
    """The command of a map as a function of state and next state, for as many commands as states.

    A step "fails" on it where no command leads to the next state.

    Attributes:
        forward: The map to invert.
        scales: Space whose command ranges correspond to the state ranges.
    """

    forward: StepMap
    scales: StepSpace

    def __post_init__(self) -> None:
        if len(self.scales.state) != len(self.scales.command):
            raise ValueError("a map is inverted only if there are as many commands as states")

    @property
    def space(self) -> StepSpace:
        """State x, and the next state y as the command."""
        after = tuple(replace(quantity, name=f"next_{quantity.name}") for quantity in self.scales.state)
        return StepSpace(self.scales.state, after)

    def evaluate(self, state: ArrayLike, command: ArrayLike) -> Outcome:
        """Commands from states x to next states y, in units of the state; NaN where none was found."""
        before, after = np.broadcast_arrays(np.asarray(state, float), np.asarray(command, float))
        pairs = zip(before.reshape(-1, before.shape[-1]), after.reshape(-1, after.shape[-1]), strict=True)
        commands = np.array([self._command(*pair) for pair in pairs]).reshape(before.shape)
        status = np.where(np.isfinite(commands).all(axis=-1), int(StepStatus.OK), int(StepStatus.INVALID))
        return Outcome(self.as_state(commands), status)

    def jacobian(self, state: ArrayLike, command: ArrayLike) -> Array:
        """∂(command in units of the state)/∂(x, y), by differences; shape (…, n, 2n)."""
        return difference_jacobian(self, state, command)

    def as_state(self, command: Array) -> Array:
        """Commands in units of the state; shape (…, n)."""
        return self.scales.state_centre + self.scales.state_scale * self.scales.point_of(command)

    def as_command(self, state: Array) -> Array:
        """Commands from units of the state, within their bounds; shape (…, n)."""
        return self.scales.command_at(self.scales.scaled_state(state))

    def read_backwards(self, logged: LoggedStep) -> LoggedStep:
        """A completed step as one of the inverse map, whose command is where it led."""
        record = logged.record
        used, led_to = self.as_state(record.requested), record.next_state
        backwards = StepRecord(record.state, led_to, led_to, used, record.status, record.context)
        return replace(logged, record=backwards)

    def _command(self, before: Array, after: Array) -> Array:
        """The command from one state to another; NaN if none was found."""
        missing = np.full(len(before), np.nan)
        if not np.isfinite([before, after]).all():
            return missing
        try:
            plan = StepController(self.forward)(before, after)
        except StepFailed:
            return missing
        return plan.command if plan.reached else missing


def inverse_of(nominal: ApexMap) -> InverseMap:
    """Inverse of the physics model, also a little beyond the robot's command bounds."""
    bounds = nominal.bounds
    wider = CommandBounds(
        WIDER * bounds.fx_lower, WIDER * bounds.fx_upper, WIDER * bounds.fy_lower, WIDER * bounds.fy_upper
    )
    return InverseMap(replace(nominal, bounds=wider), nominal.space)


def delta_command(trial: Trial) -> Sequence[Steps]:
    """A redeployment with the error of the command learned from deployment 0, with default settings."""
    inverse = inverse_of(trial.nominal)
    known = Steps(inverse.space, map(inverse.read_backwards, trial.first.completed()))
    learner = trial.learner(inverse, known, LearningSettings(), 1)
    track = partial(_track, learner, inverse, trial.nominal, reference=trial.task.reference)
    return [trial.first, trial.measure_steps(track, 1)]


def _track(
    learner: Learner, inverse: InverseMap, nominal: StepMap, plant: Plant, reference: Reference
) -> ExecutedSteps:
    """Tracks a reference with the command of the model plus its learned error; the predicted state is the target."""
    fallback = CautiousController(nominal, nominal, learner.failures)
    with plant:
        state = plant.start()
        for number, target in enumerate(reference.targets, start=1):
            found = learner.step_map().evaluate(state, target)
            known = bool(found.status == StepStatus.OK)
            command = (
                inverse.as_command(found.next_state) if known else tracking_plan(fallback, state, target, None).command
            )
            record = plant.take_step(command)
            logged = LoggedStep(learner.iteration, number, target, target, np.zeros(len(target)), record)
            yield logged
            if record.status != StepStatus.OK:
                return
            learner, state = learner.after(inverse.read_backwards(logged)), record.next_state
