"""The next command with a view to several steps: where one step cannot reach its target, or leads away from the next.

A step controller that thinks of one step takes the command whose next state is closest to the target. From there the
targets after it may be out of reach. Here the commands of several steps are chosen together, for the least sum of
squared errors: Gauss–Newton steps on all of them, with the derivatives of the map along the steps. Only the first of
them is executed; then everything is planned again (receding horizon; Rawlings, Mayne, Diehl, Model Predictive Control).
"""

from collections.abc import Sequence

import numpy as np

from stepgap.control.gauss_newton import REACHED, minimise
from stepgap.control.goal import Goal
from stepgap.control.step_controller import StepController, StepPlan
from stepgap.step import Array, StepFailed, StepMap, StepStatus

_NEGLIGIBLE = 1e-4
"""The search ends where the sum of squared errors can fall by no more than this fraction."""


def plan_ahead(step_map: StepMap, state: Array, goals: Sequence[Goal], first: StepPlan) -> StepPlan:
    """The first command of the best sequence that is found from the plans of single steps; `first` if these reach all.

    Args:
        step_map: Predicts steps; if its budget ends, that is `first`, too.
        state: State at this section; shape (n,).
        goals: What is wanted of the k next states.
        first: The plan of the first step alone.
    """
    commands, reached = _one_by_one(step_map, goals, first)
    if reached:
        return first
    space = step_map.space
    n, m = len(space.state), len(space.command)

    def path(point: Array) -> list[Array]:
        """States before each step and after the last one, for scaled commands (…, k m); each (…, n)."""
        states = [np.broadcast_to(state, (*point.shape[:-1], n))]
        for command in np.split(space.command_at(point.reshape(*point.shape[:-1], -1, m)), len(goals), axis=-2):
            states.append(step_map.evaluate(states[-1], command[..., 0, :]).next_state)
        return states

    def errors(point: Array) -> Array:
        """Errors of all next states; shape (…, number of errors)."""
        return np.concatenate([goal.errors(end) for goal, end in zip(goals, path(point)[1:], strict=True)], axis=-1)

    def jacobian(point: Array) -> Array:
        """∂errors/∂point, by the chain rule along the steps."""
        rows, by_point = [], np.zeros((n, len(point)))
        steps = zip(goals, path(point), point.reshape(-1, m), strict=False)
        for number, (goal, before, command) in enumerate(steps):
            matrix = step_map.jacobian(before, space.command_at(command))
            by_point = matrix[:, :n] @ by_point
            by_point[:, number * m : (number + 1) * m] += matrix[:, n:] * space.command_scale
            rows.append(goal.errors_by(by_point))
        return np.concatenate(rows)

    point = minimise(errors, jacobian, space.point_of(commands).reshape(-1), _NEGLIGIBLE).point
    command = space.command_at(point[:m])
    predicted, status = step_map.evaluate(state, command)
    if status != StepStatus.OK:
        return first
    distance = float(np.linalg.norm(goals[0].errors(predicted)))
    return StepPlan(command, predicted, distance <= REACHED, distance)


def _one_by_one(step_map: StepMap, goals: Sequence[Goal], first: StepPlan) -> tuple[Array, bool]:
    """Commands (k, m) of steps that are planned one after the other, and whether all of them have no error."""
    controller, plan, commands, reached = StepController(step_map), first, [first.command], first.reached
    for goal in goals[1:]:
        try:
            plan = controller.towards(plan.predicted, goal, plan.command)
        except StepFailed:
            return np.array([*commands, *[plan.command] * (len(goals) - len(commands))]), False
        commands.append(plan.command)
        reached &= plan.reached
    return np.array(commands), bool(reached)
