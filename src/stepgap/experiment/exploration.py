"""Exploration: the choice of the most informative first steps, before tracking starts.

The value of a step is the reduction of the map's variance at the points that the reference needs (I-optimal design of
experiments; Atkinson, Donev, Tobias, Optimum Experimental Designs, ch. 10). The variance of a residual hardly depends
on the measured value, so it can be computed before the step: the step is appended with its predicted value.

With a prior over robots it is known beforehand what further steps are worth: by how much they lower the expected error
of the reference, each of whose different steps is also learned from when it occurs first. The unit is the squared error
that one step has by noise alone, so that a step that is worth less than one costs more than it saves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stepgap.control.box_points import box_points
from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.residual import Residual
from stepgap.step import Array, StepFailed, StepMap

TRIED = 25
SECOND = 13
"""Numbers of commands that are compared for the next step, and of those with which each is followed."""
MARGIN = 0.1  # Distance by which an exploratory step may leave the range of the targets [half ranges]
LEAST_WORTH = 1.0  # What an exploratory step must be worth [squared errors of a step by noise]


@dataclass(frozen=True, eq=False)
class Goals:
    """Points at which the map must be known.

    Attributes:
        points: States and commands, concatenated, in the order in which they occur first; shape (G, n + m).
        weights: Number of times that each is needed; shape (G,).
        scale: Scales by which the errors of the state coordinates are divided, infinite for those that do not count;
            shape (n,).
    """

    points: Array
    weights: Array
    scale: Array

    def uncertainty_after(self, residual: Residual, *points: Array) -> float:
        """Mean variance of the residual after steps at these points (n + m,) [squared scales]."""
        for point in points:
            residual = residual.append(point, residual.mean(point))
        variance = np.sum((residual.std(self.points) / self.scale) ** 2, axis=-1)
        return float(self.weights @ variance / self.weights.sum())

    def expected_loss(self, residual: Residual, noise_std: Array) -> float:
        """Sum of the variances of the residual when each step occurs first [squared errors of a step by noise].

        Args:
            residual: The residual, which may have been conditioned on predicted values. As these have no errors, its
                noise seems smaller than it is, and the variances in proportion.
            noise_std: Standard deviation of the noise of a step before that; shape (n,).
        """
        noise = float(np.sum((noise_std / self.scale) ** 2))
        loss = 0.0
        for point in self.points:
            std = residual.std(point) * noise_std / residual.noise_std
            loss += float(np.sum((std / self.scale) ** 2))
            residual = residual.append(point, residual.mean(point))
        return loss / noise


def goals_of(reference: Reference, step_map: StepMap) -> Goals:
    """Steps that the reference needs, each from target to target, with their commands by the map."""
    first, number = reference.distinct
    targets = whole_states(step_map, reference.targets[first])[number]
    before = np.concatenate([targets[:1], targets[:-1]])
    steps, at, counts = np.unique(np.stack([before, targets], axis=1), axis=0, return_index=True, return_counts=True)
    points = []
    weights = []
    controller = StepController(step_map)
    order = np.argsort(at)
    for (state, target), count in zip(steps[order], counts[order], strict=True):
        try:
            points.append(np.append(state, controller(state, target).command))
            weights.append(count)
        except StepFailed:
            continue
    return Goals(np.array(points), np.array(weights, float), step_map.space.error_scale)


def worth_of_steps(controller: CautiousController, residual: Residual, reference: Reference, most: int) -> list[float]:
    """What each exploratory step is expected to be worth, up to the first that is not worth it [`LEAST_WORTH`].

    Args:
        controller: Plans the first step.
        residual: Error of its nominal map, with a prior over robots.
        reference: Its first target is where the first step begins.
        most: Largest number of steps.
    """
    worths = list[float]()
    before = 0.0
    noise_std = residual.noise_std
    state = whole_states(controller.nominal, reference.targets[:1])[0]
    goals = goals_of(reference, controller.step_map)
    for number in range(most + 1):
        loss = goals.expected_loss(residual, noise_std)
        if number:
            worths.append(before - loss)
        if number == most or (worths and worths[-1] < LEAST_WORTH):
            break
        plan = exploration_plan(controller, residual, state, goals)
        point = np.append(state, plan.command)
        residual = residual.append(point, residual.mean(point))
        state = plan.predicted
        before = loss
        step_map = CorrectedMap(controller.nominal, residual)
        controller = replace(controller, step_map=step_map, previous=plan.command)
    return worths


def worthwhile(worths: Sequence[float]) -> int:
    """Number of exploratory steps that are made, of those whose worth `worth_of_steps` has found."""
    return sum(worth >= LEAST_WORTH for worth in worths)


def exploration_plan(controller: CautiousController, residual: Residual, state: Array, goals: Goals) -> CautiousPlan:
    """The safe command that, together with the next one, gives the smallest uncertainty at the goals.

    It leads to a state in the range of the goals, or as close to it as possible.

    Raises:
        StepFailed: None of the compared commands makes a step.
    """
    step_map = controller.step_map
    space = controller.bounds
    n = len(space.state)
    m = len(space.command)
    commands = space.command_at(box_points(TRIED, m))
    safe = np.array([command for command in commands if controller.is_safe(state, command)]).reshape(-1, m)
    if not len(safe):
        return controller(state, goals.points[0, :n])
    ends = step_map.evaluate(state, safe).next_state
    lower = goals.points[:, :n].min(axis=0)
    upper = goals.points[:, :n].max(axis=0)
    outside = np.linalg.norm((ends - np.clip(ends, lower, upper)) / space.state_scale, axis=-1)
    allowed = np.flatnonzero(outside <= max(float(outside.min()), MARGIN))

    def uncertainty(i: int) -> float:
        first = np.append(state, safe[i])
        second = [np.append(ends[i], command) for command in commands[:: max(1, round(len(commands) / SECOND))]]
        return min(goals.uncertainty_after(residual, first, point) for point in second)

    best = min(allowed.tolist(), key=uncertainty)
    return CautiousPlan(safe[best], ends[best], controller.step_std(state, safe[best]))
