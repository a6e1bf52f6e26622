"""The next command with a view to several steps: where one step cannot reach its target, or leads away from the next.

A step controller that thinks of one step takes the command whose next state is closest to the target. From there the
targets after it may be out of reach. Here the commands of several steps are chosen together, for the least expected sum
of squared errors: Gauss–Newton steps on all of them, with the derivatives of the map along the steps. Only the first of
them is executed; then everything is planned again (receding horizon; Rawlings, Mayne, Diehl, Model Predictive Control).

The variance of each step counts as in `CautiousController`, at the states where the steps are expected to begin. That
these are uncertain, too, is neglected: the next plan begins at a measured one.
"""

from collections.abc import Sequence

import numpy as np

from stepgap.control.command_change import NO_LIMIT, CommandChange
from stepgap.control.gauss_newton import REACHED, minimise, norms
from stepgap.control.goal import Goal
from stepgap.control.step_controller import StepController, StepPlan
from stepgap.step import Array, StepFailed, StepMap, StepStatus

AHEAD_IMPROVEMENT = 1e-4
"""The search ends where the sum of squared errors can fall by no more than this fraction."""


def plan_ahead(
    step_map: StepMap,
    state: Array,
    goals: Sequence[Goal],
    first: StepPlan,
    others: Sequence[Array] = (),
    cautious: bool = True,
    change: CommandChange = NO_LIMIT,
) -> StepPlan:
    """The first command of the best sequence that is found from the plans of single steps; `first` if these reach all.

    Args:
        step_map: Predicts steps; if its budget ends, that is `first`, too.
        state: State at this section; shape (n,).
        goals: What is wanted of the k next states.
        first: The plan of the first step alone.
        others: Other commands of the first step; the sequence is not worse than one that begins with any of them.
            Shape (m,).
        cautious: Whether variances count.
        change: How much the first command may differ from the one before it.
    """
    commands, reached = _one_by_one(step_map, goals, first, change)
    if reached:
        return first
    space = step_map.space
    n, m = len(space.state), len(space.command)
    # A later command may be as many changes away; that it also follows the one before it is left to the next plans.
    boxes = [change.bounds(space, number) for number in range(1, len(goals) + 1)]
    known = dict[tuple[int, bytes], tuple[list[Array], list[Array]]]()  # so that a Jacobian repeats no step

    def path(points: Array) -> tuple[list[Array], list[Array]]:
        """States before each step and after the last one, and standard deviations, for scaled commands (…, k m)."""
        key = points.ndim, points.tobytes()
        if key not in known:
            states, stds = [np.broadcast_to(state, (*points.shape[:-1], n))], list[Array]()
            for box, scaled in zip(boxes, np.split(points, len(goals), axis=-1), strict=True):
                command = box.command_at(scaled)
                stds.append(step_map.std(states[-1], command))
                states.append(step_map.evaluate(states[-1], command).next_state)
            known[key] = states, stds
        return known[key]

    def errors(points: Array) -> Array:
        """Numbers whose squares add up to the expected squared errors of all next states; shape (…, r)."""
        states, stds = path(points)
        means = [goal.errors(end) for goal, end in zip(goals, states[1:], strict=True)]
        spreads = [goal.spread(std.T).T for goal, std in zip(goals, stds, strict=True)] if cautious else []
        return np.concatenate([*means, *spreads], axis=-1)

    def jacobian(point: Array) -> Array:
        """∂errors/∂point, by the chain rule along the steps."""
        means, spreads, by_point = [], [], np.zeros((n, len(point)))
        by_own = np.eye(len(point)).reshape(-1, m, len(point))
        for goal, box, before, scaled, own in zip(
            goals, boxes, path(point)[0], point.reshape(-1, m), by_own, strict=False
        ):
            command, by_input = box.command_at(scaled), np.vstack([by_point, own * box.command_scale[:, None]])
            spreads.append(goal.spread(step_map.std_gradient(before, command) @ by_input))
            by_point = step_map.jacobian(before, command) @ by_input
            means.append(goal.errors_by(by_point))
        return np.concatenate([*means, *spreads] if cautious else means)

    starts = [commands, *([other, *commands[1:]] for other in others)]
    points = np.array(
        [np.concatenate([box.point_of(at) for box, at in zip(boxes, each, strict=True)]) for each in starts]
    )
    best = points[np.argmin(norms(errors(points)))]
    command = boxes[0].command_at(minimise(errors, jacobian, best, AHEAD_IMPROVEMENT).point[:m])
    predicted, status = step_map.evaluate(state, command)
    if status != StepStatus.OK:
        return first
    distance = float(np.linalg.norm(goals[0].errors(predicted)))
    return StepPlan(command, predicted, distance <= REACHED, distance)


def _one_by_one(step_map: StepMap, goals: Sequence[Goal], first: StepPlan, change: CommandChange) -> tuple[Array, bool]:
    """Commands (k, m) of steps that are planned one after the other, and whether all of them have no error."""
    plan, commands, reached = first, [first.command], first.reached
    for goal in goals[1:]:
        try:
            controller = StepController(change.after(plan.command).limited(step_map))
            plan = controller.towards(plan.predicted, goal, plan.command)
        except StepFailed:
            return np.array([*commands, *[plan.command] * (len(goals) - len(commands))]), False
        commands.append(plan.command)
        reached &= plan.reached
    return np.array(commands), bool(reached)
