"""The next command with a view to several steps: where one step cannot reach its target, or leads away from the next.

A step controller that thinks of one step takes the command whose next state is closest to the target. From there the
targets after it may be out of reach. Here the commands of several steps are chosen together, for the least sum of
squared errors: Gauss–Newton steps on all of them, with the derivatives of the map along the steps. Only the first of
them is executed; then everything is planned again (receding horizon; Rawlings, Mayne, Diehl, Model Predictive Control).
"""

import numpy as np

from stepgap.control.gauss_newton import REACHED, minimise
from stepgap.control.step_controller import StepController, StepPlan
from stepgap.step import Array, StepFailed, StepMap, StepStatus

_NEGLIGIBLE = 1e-4
"""The search ends where the sum of squared errors can fall by no more than this fraction."""


def plan_ahead(step_map: StepMap, state: Array, targets: Array, first: StepPlan) -> StepPlan:
    """The first command of the best sequence that is found from the plans of single steps; `first` if these reach all.

    Args:
        step_map: Predicts steps; if its budget ends, that is `first`, too.
        state: State at this section; shape (n,).
        targets: Targets of the next steps, NaN in coordinates without one; shape (k, n).
        first: The plan of the first step alone.
    """
    commands, reached = _one_by_one(step_map, targets, first)
    if reached:
        return first
    space = step_map.space
    n, m = len(space.state), len(space.command)
    wanted = space.has_target(targets)

    def path(point: Array) -> list[Array]:
        """States before each step and after the last one, for scaled commands (…, k m); each (…, n)."""
        states = [np.broadcast_to(state, (*point.shape[:-1], n))]
        for command in np.split(space.command_at(point.reshape(*point.shape[:-1], -1, m)), len(targets), axis=-2):
            states.append(step_map.evaluate(states[-1], command[..., 0, :]).next_state)
        return states

    def errors(point: Array) -> Array:
        """Scaled errors of all targets; shape (…, number of targets)."""
        ends = np.stack(path(point)[1:], axis=-2)
        return ((ends - targets) / space.error_scale)[..., wanted]

    def jacobian(point: Array) -> Array:
        """∂errors/∂point, by the chain rule along the steps."""
        rows, by_point = [], np.zeros((n, len(point)))
        for number, (before, command) in enumerate(zip(path(point), point.reshape(-1, m), strict=False)):
            matrix = step_map.jacobian(before, space.command_at(command))
            by_point = matrix[:, :n] @ by_point
            by_point[:, number * m : (number + 1) * m] += matrix[:, n:] * space.command_scale
            rows.append(by_point / space.error_scale[:, None])
        return np.array(rows)[wanted]

    point = minimise(errors, jacobian, space.point_of(commands).reshape(-1), _NEGLIGIBLE).point
    command = space.command_at(point[:m])
    predicted, status = step_map.evaluate(state, command)
    if status != StepStatus.OK:
        return first
    distance = float(np.linalg.norm(((predicted - targets[0]) / space.error_scale)[wanted[0]]))
    return StepPlan(command, predicted, distance <= REACHED, distance)


def _one_by_one(step_map: StepMap, targets: Array, first: StepPlan) -> tuple[Array, bool]:
    """Commands (k, m) of steps that are planned one after the other, and whether all of them reach their targets."""
    controller, plan, commands, reached = StepController(step_map), first, [first.command], first.reached
    for target in targets[1:]:
        try:
            plan = controller(plan.predicted, target, plan.command)
        except StepFailed:
            return np.array([*commands, *[plan.command] * (len(targets) - len(commands))]), False
        commands.append(plan.command)
        reached &= plan.reached
    return np.array(commands), bool(reached)
