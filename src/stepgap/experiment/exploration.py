"""Which step teaches most: the choice of the first hops, before tracking starts.

A step is worth what it takes from the variance of the map where the reference will need it (I-optimal design of
experiments; Atkinson, Donev, Tobias, Optimum Experimental Designs, ch. 10). A residual's variance hardly depends on
what a step measures, so it is known before the step is taken: append the step as the residual expects it.
"""

from dataclasses import dataclass

import numpy as np

from stepgap.control.cautious_controller import CautiousController, CautiousPlan
from stepgap.control.reference import Reference
from stepgap.control.step_controller import StepController
from stepgap.learning.residual import Residual
from stepgap.step import Array, StepFailed, StepMap

TRIED = 5
"""Commands along each axis that are compared."""
MARGIN = 0.1
"""How far a calibrating step may leave the range of the targets [half ranges]."""


@dataclass(frozen=True, eq=False)
class Goals:
    """Where the map must be known.

    Attributes:
        points: States and commands side by side; shape (G, n + m).
        weights: How often each is needed; shape (G,).
        scale: By which errors of the state coordinates are compared; shape (n,).
    """

    points: Array
    weights: Array
    scale: Array

    def uncertainty_after(self, residual: Residual, *points: Array) -> float:
        """Mean variance of the residual once steps at these points (n + m,) have been taken [squared scales]."""
        for point in points:
            residual = residual.append(point, residual.mean(point))
        variance = np.sum((residual.std(self.points) / self.scale) ** 2, axis=-1)
        return float(self.weights @ variance / self.weights.sum())


def goals_of(reference: Reference, step_map: StepMap) -> Goals:
    """The steps that the reference asks for, each from target to target, with the commands that the map gives them."""
    before = np.concatenate([reference.targets[:1], reference.targets[:-1]])
    steps, counts = np.unique(np.stack([before, reference.targets], axis=1), axis=0, return_counts=True)
    points, weights, controller = [], [], StepController(step_map)
    for (state, target), count in zip(steps, counts, strict=True):
        try:
            points.append(np.append(state, controller(state, target).command))
            weights.append(count)
        except StepFailed:
            continue
    return Goals(np.array(points), np.array(weights, float), step_map.space.state_scale)


def calibrating_plan(controller: CautiousController, residual: Residual, state: Array, goals: Goals) -> CautiousPlan:
    """The safe command that, with the one after it, leaves the least uncertainty at the goals.

    It leads to a state in the range of the goals, or as near to it as one can be had.

    Raises:
        StepFailed: No command that was searched makes a step.
    """
    step_map, space = controller.step_map, controller.step_map.space
    n, m = len(space.state), len(space.command)
    commands = space.command_grid(TRIED).reshape(-1, m)
    safe = np.array([command for command in commands if controller.is_safe(state, command)]).reshape(-1, m)
    if not len(safe):
        return controller(state, goals.points[0, :n])
    ends = step_map.evaluate(state, safe).next_state
    lower, upper = goals.points[:, :n].min(axis=0), goals.points[:, :n].max(axis=0)
    outside = np.linalg.norm((ends - np.clip(ends, lower, upper)) / space.state_scale, axis=-1)
    allowed = np.flatnonzero(outside <= max(float(outside.min()), MARGIN))

    def left(i: int) -> float:
        here = np.append(state, safe[i])
        onward = [np.append(ends[i], command) for command in commands[:: TRIED // 2]]
        return min(goals.uncertainty_after(residual, here, point) for point in onward)

    best = min(allowed.tolist(), key=left)
    return CautiousPlan(safe[best], ends[best], controller.step_std(state, safe[best]))
