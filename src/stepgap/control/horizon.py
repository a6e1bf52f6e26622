"""The next command with a view to several steps: where one step cannot reach its target, or leads away from the next.

A step controller that thinks of one step takes the command whose next state is closest to the target. From there the
targets after it may be out of reach. Here the commands of several steps are chosen together, for the least expected sum
of squared errors: Gauss–Newton steps on all of them, with the derivatives of the map along the steps. Only the first of
them is executed; then everything is planned again (receding horizon; Rawlings, Mayne, Diehl, Model Predictive Control).

The variance of each step counts as in `CautiousController`, at the states where the steps are expected to begin. That
these are uncertain, too, is neglected: the next plan begins at a measured one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from stepgap.control.gauss_newton import REACHED, minimise, norms
from stepgap.control.goal import Goal
from stepgap.control.step_controller import StepController, StepPlan
from stepgap.control.wrapped_map import NO_LIMIT, CommandChange
from stepgap.step import Array, StepFailed, StepMap, StepSpace, StepStatus

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
    sequence = _Sequence(step_map, state, goals, change, cautious)
    starts = np.array([sequence.point_of([start, *commands[1:]]) for start in (first.command, *others)])
    best = starts[np.argmin(norms(sequence.errors(starts)))]
    solution = minimise(sequence.errors, sequence.jacobian, best, AHEAD_IMPROVEMENT)
    command = sequence.commands_at(solution.point)[0]
    predicted, status = step_map.evaluate(state, command)
    if status != StepStatus.OK or not np.isfinite(solution.distance):  # a later step of every sequence fails
        return first
    distance = float(np.linalg.norm(goals[0].errors(predicted)))
    return StepPlan(command, predicted, distance <= REACHED, distance)


def _one_by_one(step_map: StepMap, goals: Sequence[Goal], first: StepPlan, change: CommandChange) -> tuple[Array, bool]:
    """Commands (k, m) of steps that are planned one after the other, and whether all of them have no error."""
    plan = first
    commands = [first.command]
    reached = first.reached
    for goal in goals[1:]:
        try:
            controller = StepController(change.after(plan.command).limited(step_map))
            plan = controller.towards(plan.predicted, goal, plan.command)
        except StepFailed:
            return np.array([*commands, *[plan.command] * (len(goals) - len(commands))]), False
        commands.append(plan.command)
        reached &= plan.reached
    return np.array(commands), bool(reached)


@dataclass(frozen=True, eq=False)
class _Sequence:
    """Steps from one state as functions of a point: their k commands one after the other, scaled by their bounds.

    Attributes:
        step_map: Predicts steps.
        state: State before the first one; shape (n,).
        goals: What is wanted of their k next states.
        change: How much the first command may differ from the one before it. A later one may be as many changes away;
            that it also follows the one before it is left to the next plans.
        cautious: Whether variances count.
    """

    step_map: StepMap
    state: Array
    goals: Sequence[Goal]
    change: CommandChange
    cautious: bool
    _paths: dict[tuple[int, bytes], tuple[list[Array], list[Array]]] = field(default_factory=dict)

    @cached_property
    def _bounds(self) -> list[StepSpace]:
        """The space with the bounds of each command."""
        return [self.change.bounds(self.step_map.space, number) for number in range(1, len(self.goals) + 1)]

    def point_of(self, commands: Sequence[Array]) -> Array:
        """The point of k commands (m,); shape (k m,)."""
        return np.concatenate([box.point_of(command) for box, command in zip(self._bounds, commands, strict=True)])

    def commands_at(self, points: Array) -> list[Array]:
        """The k commands at points (…, k m); each (…, m)."""
        parts = np.split(points, len(self.goals), axis=-1)
        return [box.command_at(part) for box, part in zip(self._bounds, parts, strict=True)]

    def _path(self, points: Array) -> tuple[list[Array], list[Array]]:
        """States before each step and after the last one, and standard deviations of the steps; each (…, n).

        They are kept, so that a Jacobian evaluates no step again.
        """
        key = points.ndim, points.tobytes()
        if key not in self._paths:
            states = [np.broadcast_to(self.state, (*points.shape[:-1], len(self.state)))]
            stds = list[Array]()
            for command in self.commands_at(points):
                stds.append(self.step_map.std(states[-1], command))
                states.append(self.step_map.evaluate(states[-1], command).next_state)
            self._paths[key] = states, stds
        return self._paths[key]

    def errors(self, points: Array) -> Array:
        """Numbers whose squares add up to the costs of all next states; (…, k m) to (…, r)."""
        states, stds = self._path(points)
        means = [goal.errors(end) for goal, end in zip(self.goals, states[1:], strict=True)]
        spreads = [goal.spread(std.T).T for goal, std in zip(self.goals, stds, strict=True)] if self.cautious else []
        return np.concatenate([*means, *spreads], axis=-1)

    def jacobian(self, point: Array) -> Array:
        """∂errors/∂point, by the chain rule along the steps; shape (r, k m)."""
        means = []
        spreads = []
        by_point = np.zeros((len(self.state), len(point)))
        own = np.split(np.eye(len(point)), len(self.goals))
        steps = zip(self.goals, self._bounds, self._path(point)[0], self.commands_at(point), own, strict=False)
        for goal, box, before, command, rows in steps:
            by_input = np.vstack([by_point, rows * box.command_scale[:, None]])
            spreads.append(goal.spread(self.step_map.std_gradient(before, command) @ by_input))
            by_point = self.step_map.jacobian(before, command) @ by_input
            means.append(goal.errors_by(by_point))
        return np.concatenate([*means, *spreads] if self.cautious else means)
