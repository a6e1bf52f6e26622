"""Exploration: the choice of the most informative first steps, before tracking starts.

The value of a step is the reduction of the map's variance at the points that the reference needs (I-optimal design of
experiments; Atkinson, Donev, Tobias, Optimum Experimental Designs, ch. 10). The variance of a residual hardly depends
on the measured value, so it can be computed before the step: the step is appended with its predicted value.
"""

from dataclasses import dataclass

import numpy as np

from stepgap.control.box_points import box_points
from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.reach import whole_states
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.learning.residual import Residual
from stepgap.step import Array, StepFailed, StepMap

TRIED, SECOND = 25, 13
"""Numbers of commands that are compared for the next step, and of those with which each is followed."""
MARGIN = 0.1
"""Distance by which an exploratory step may leave the range of the targets [half ranges]."""


@dataclass(frozen=True, eq=False)
class Goals:
    """Points at which the map must be known.

    Attributes:
        points: States and commands, concatenated; shape (G, n + m).
        weights: Number of times that each is needed; shape (G,).
        scale: Scales by which the errors of the state coordinates are divided; shape (n,).
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


def goals_of(reference: Reference, step_map: StepMap) -> Goals:
    """Steps that the reference needs, each from target to target, with their commands by the map."""
    first, number = reference.distinct
    targets = whole_states(step_map, reference.targets[first])[number]
    before = np.concatenate([targets[:1], targets[:-1]])
    steps, counts = np.unique(np.stack([before, targets], axis=1), axis=0, return_counts=True)
    points, weights, controller = [], [], StepController(step_map)
    for (state, target), count in zip(steps, counts, strict=True):
        try:
            points.append(np.append(state, controller(state, target).command))
            weights.append(count)
        except StepFailed:
            continue
    return Goals(np.array(points), np.array(weights, float), step_map.space.state_scale)


def exploration_plan(controller: CautiousController, residual: Residual, state: Array, goals: Goals) -> CautiousPlan:
    """The safe command that, together with the next one, gives the smallest uncertainty at the goals.

    It leads to a state in the range of the goals, or as close to it as possible.

    Raises:
        StepFailed: None of the compared commands makes a step.
    """
    step_map, space = controller.step_map, controller.bounds
    n, m = len(space.state), len(space.command)
    commands = space.command_at(box_points(TRIED, m))
    safe = np.array([command for command in commands if controller.is_safe(state, command)]).reshape(-1, m)
    if not len(safe):
        return controller(state, goals.points[0, :n])
    ends = step_map.evaluate(state, safe).next_state
    lower, upper = goals.points[:, :n].min(axis=0), goals.points[:, :n].max(axis=0)
    outside = np.linalg.norm((ends - np.clip(ends, lower, upper)) / space.state_scale, axis=-1)
    allowed = np.flatnonzero(outside <= max(float(outside.min()), MARGIN))

    def uncertainty(i: int) -> float:
        first = np.append(state, safe[i])
        second = [np.append(ends[i], command) for command in commands[:: max(1, round(len(commands) / SECOND))]]
        return min(goals.uncertainty_after(residual, first, point) for point in second)

    best = min(allowed.tolist(), key=uncertainty)
    return CautiousPlan(safe[best], ends[best], controller.step_std(state, safe[best]))
