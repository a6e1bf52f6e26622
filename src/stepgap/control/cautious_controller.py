"""Cautious control: the least error that can be relied on where a map is uncertain, by a step that is unlikely to fail.

The expected squared distance of the next state from the target is |mean − target|² + variance (cautious control in
the sense of Åström and Wittenmark, Adaptive Control). The *cautious cost*, which is minimised, counts the variance
`CAUTION`² times. Where the map's error is well known, the variance is the same for all commands, and the minimum is
where mean = target (Eq. 13). Elsewhere the minimum is closer to the commands that have been tried, so the data limit
how far a command departs from them, and with more data it departs farther. The command of the nominal map is always
among those compared, so under the map's own uncertainty a correction never makes this cost larger; if several steps
are planned together, it is their sum that is not larger than with that command first.

A state is *viable* here if some command makes a step from it (compare Wieber, On the stability of walking
systems, 2002).
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from stepgap.control.box_points import box_points, composite_design
from stepgap.control.command_before import COMMAND_WEIGHT, MapWithCommand, StandingMap, space_with_command
from stepgap.control.command_table import CommandTable
from stepgap.control.gauss_newton import minimise
from stepgap.control.goal import UNTRACKED_WEIGHT, Goal, ToStanding, goals_for
from stepgap.control.horizon import plan_ahead
from stepgap.control.settings import ALL_RULES, ControlSettings
from stepgap.control.step_controller import StepController, as_vector, checked_target
from stepgap.control.wrapped_map import BudgetedMap, CommandChange, EvaluationBudget
from stepgap.step import Array, CommandBefore, StepFailed, StepMap, StepSpace, StepStatus

RISK = 2.0  # The next state must be viable even if it is off by this number of standard deviations
FAILURE_RADIUS = 0.2
"""A step closer than this to one that failed, in every coordinate, is not taken [half ranges]."""
SEARCH_POINTS = 81
"""Commands that are searched if no better command is safe; fewer if their evaluation takes more than `SEARCH_SHARE` of
the budget."""
SEARCH_SHARE = 0.25
IMPROVEMENT = 1e-6
"""The search for the least cautious cost ends where that can fall by no more than this fraction."""


@dataclass(frozen=True, eq=False)
class CautiousPlan:
    """A command and the prediction of its step.

    Attributes:
        command: Within the bounds; shape (m,).
        predicted: Next state; shape (n,).
        std: Standard deviation of the measured next state; shape (n,).
    """

    command: Array
    predicted: Array
    std: Array


@dataclass(frozen=True, eq=False)
class CautiousController:
    """Finds the safe command of least cautious cost.

    Attributes:
        step_map: Predicts steps and their standard deviations.
        nominal: Nominal map that `step_map` corrects; it may be the same map.
        failures: Points (state, command) of steps that failed; shape (k, n + m).
        settings: Which rules apply.
        table: Table of the commands of `step_map`, used in place of solving; None to solve.
        previous: Command of the step before, from which the next one may differ by `settings.largest_change`; None for
            no limit. Shape (m,).
        untracked: Weights of the coordinates without a target, as of `goals_for`.
        around: Least and largest command beside the other limits, as of `CommandChange`.
        standing: As of `goals_for`.
    """

    step_map: StepMap
    nominal: StepMap
    failures: Array
    settings: ControlSettings = ALL_RULES
    table: CommandTable | None = None
    previous: Array | None = None
    untracked: Array | float = UNTRACKED_WEIGHT
    around: tuple[Array, Array] | None = None
    standing: ToStanding | None = None

    @property
    def change(self) -> CommandChange:
        """How much the next command may differ from the one before."""
        return CommandChange(self.settings.largest_change, self.previous, self.around)

    @cached_property
    def bounds(self) -> StepSpace:
        """The space with the bounds of the next command."""
        return self.change.bounds(self.step_map.space)

    def __call__(
        self, state: ArrayLike, target: ArrayLike, guess: ArrayLike | None = None, ahead: ArrayLike = ()
    ) -> CautiousPlan:
        """Plans one step.

        Args:
            state: State at this section; shape (n,).
            target: State wanted at the next section, NaN in coordinates without a target; shape (n,).
            guess: Command to start from; the middle of the bounds if none. Shape (m,).
            ahead: Targets of the steps after it, which are planned together with it; shape (k, n).

        Raises:
            StepFailed: No command that was searched makes a step.
            ValueError: State, target or guess has the wrong size, a target is infinite, or the guess is not finite.
        """
        space = self.step_map.space
        targets = np.array([checked_target(space, row) for row in (target, *np.asarray(ahead))])
        before = self.step_map.command_before
        if before is not None and self.table is None:
            return self._with_command_before(before, state, targets, guess)
        searching = self._with_half_the_budget()
        checking = self._with_half_the_budget()
        predicting = searching.step_map
        goals = goals_for(self._with_half_the_budget().step_map, targets, self.untracked, self.standing)
        goal = goals.onward[0]
        solver = StepController(self.change.limited(predicting))
        exact = self.table(state, target, guess) if self.table else solver.towards(state, goal, guess)
        state = np.asarray(state, float)
        certain = self._is_certain(state, exact.command)
        nominal = [] if certain else searching._nominal_commands(state, goal, exact.command)
        plans = [exact] if certain else []
        if len(targets) > 1:
            cautious = self.settings.cautious
            together = goals.together
            joint = plan_ahead(predicting, state, together, exact, nominal, cautious, self.change)
            plans = [joint, *plans] if joint is not exact else plans
        for plan in plans:
            step_std = self.step_std(state, plan.command)
            if checking._is_viable(state, plan.command, plan.predicted, step_std):
                return CautiousPlan(plan.command, plan.predicted, step_std)
        nominal = nominal or searching._nominal_commands(state, goal, exact.command)
        commands = np.array([exact.command, *nominal, *searching._local_minima(state, goal, [exact.command, *nominal])])
        best = checking._best(state, goal, commands)
        if best is None:
            everywhere = box_points(searched_commands(self.settings), len(self.bounds.command))
            best = checking._best(state, goal, self.bounds.command_at(everywhere))
        command = exact.command if best is None else best
        return CautiousPlan(command, self.step_map(state, command), self.step_std(state, command))

    def _with_command_before(
        self, before: CommandBefore, state: ArrayLike, targets: Array, guess: ArrayLike | None
    ) -> CautiousPlan:
        """Plans with the command of the step before as a part of the state.

        Args:
            before: Its effect.
            state: As of a call.
            targets: Of the step and of those after it; shape (1 + k, n).
            guess: As of a call.
        """
        n, m = before.effect.shape
        space = space_with_command(self.step_map.space)
        start = as_vector("state", state, n)
        without_effect = CommandBefore(np.zeros((n, m)), before.command, np.zeros((n, n)))
        # The command before a failed step is not compared with the present one.
        present = np.tile(before.command, (len(self.failures), 1))
        whole = replace(
            self,
            step_map=MapWithCommand(self.step_map, space, before, start),
            nominal=MapWithCommand(self.nominal, space, without_effect, start),
            failures=np.hstack([self.failures[:, :n], present, self.failures[:, n:]]),
            untracked=np.repeat([UNTRACKED_WEIGHT, COMMAND_WEIGHT], [n, m]),
            standing=partial(StandingMap, quantities=self.step_map.space),
        )
        first, *later = np.hstack([targets, np.full((len(targets), m), np.nan)])
        plan = whole(np.append(start, before.command), first, guess, later)
        return CautiousPlan(plan.command, plan.predicted[:n], plan.std[:n])

    def step_std(self, state: ArrayLike, command: ArrayLike) -> Array:
        """Standard deviation of the measured next state; shape (…, n)."""
        return np.hypot(self.step_map.std(state, command), self.step_map.noise_std)

    def _with_half_the_budget(self) -> "CautiousController":
        """This controller, whose maps evaluate half of the permitted steps: for the search, or for its checks."""
        budget = EvaluationBudget(self.settings.evaluations // 2)
        return replace(self, step_map=BudgetedMap(self.step_map, budget), nominal=BudgetedMap(self.nominal, budget))

    def _is_certain(self, state: Array, command: Array) -> bool:
        """Whether the map's error is smaller than the scatter of a measured step.

        Where it is, all commands have the same variance.
        """
        certain = self.step_map.std(state, command) <= self.step_map.noise_std
        return not self.settings.cautious or bool(certain[self.step_map.space.tracked].all())

    def _nominal_commands(self, state: Array, goal: Goal, start: Array) -> list[Array]:
        try:
            return [StepController(self.change.limited(self.nominal)).towards(state, goal, start).command]
        except StepFailed:
            return []

    def _local_minima(self, state: Array, goal: Goal, starts: list[Array]) -> list[Array]:
        """The local minimum of the cautious cost from the best start, if variance counts.

        From the other start the same minimum was found, in all of some hundred plans of three robots.
        """
        if not self.settings.cautious:
            return []
        better = starts[np.argsort(self._cautious_costs(state, goal, np.array(starts)))[0]]  # NaN comes last
        return [self._local_minimum(state, goal, better)]

    def _local_minimum(self, state: Array, goal: Goal, start: Array) -> Array:
        """The command of least cautious cost that is found from `start`; shape (m,)."""
        space = self.bounds
        n = len(state)

        def deviations(point: Array) -> Array:
            command = space.command_at(point)
            errors = goal.errors(self.step_map.evaluate(state, command).next_state)
            return np.concatenate([errors, goal.spread(self.step_map.std(state, command).T).T], axis=-1)

        def jacobian(point: Array) -> Array:
            command = space.command_at(point)
            parts = self.step_map.jacobian(state, command), self.step_map.std_gradient(state, command)
            mean, std = (part[:, n:] * space.command_scale for part in parts)
            return np.concatenate([goal.errors_by(mean), goal.spread(std)])

        return space.command_at(minimise(deviations, jacobian, space.point_of(start), improvement=IMPROVEMENT).point)

    def _best(self, state: Array, goal: Goal, commands: Array) -> Array | None:
        """The safe command of least cautious cost among commands (k, m); None if none is safe."""
        for i in np.argsort(self._cautious_costs(state, goal, commands)):  # NaN comes last
            if self.is_safe(state, commands[i]):
                return commands[i]
        return None

    def _cautious_costs(self, state: Array, goal: Goal, commands: Array) -> Array:
        """Cautious costs of commands (k, m); shape (k,), NaN where the step fails."""
        mean = self.step_map.evaluate(state, commands).next_state
        squares = np.sum(goal.errors(mean) ** 2, axis=-1) + 0.0 * mean.sum(axis=-1)  # NaN also without any error
        if self.settings.cautious:
            squares += np.sum(goal.spread(self.step_map.std(state, commands).T) ** 2, axis=0)
        return squares

    def is_safe(self, state: ArrayLike, command: Array) -> bool:
        """Whether the step has a next state, this is viable despite the errors, and it resembles no failure."""
        mean, status = self.step_map.evaluate(state, command)
        return bool(status == StepStatus.OK) and self._is_viable(state, command, mean, self.step_std(state, command))

    def _is_viable(self, state: ArrayLike, command: Array, mean: Array, std: Array) -> bool:
        """Whether a step with this mean and standard deviation (n,) ends in a viable state and resembles no failure."""
        space = self.step_map.space
        scale = np.concatenate([space.state_scale, space.command_scale])
        distance = np.abs(self.failures - np.concatenate([state, command])) / scale
        if self.settings.avoid_failures and (distance.max(axis=-1, initial=0.0) < FAILURE_RADIUS).any():
            return False
        if not self.settings.viability:
            return True
        error = np.diag(RISK * std)
        next_states = np.concatenate([mean[None], mean + error, mean - error])
        after = self.change.after(command).bounds(space)
        doubtful = next_states[self.nominal.evaluate(next_states, after.command_centre).status != StepStatus.OK]
        if not len(doubtful):
            return True
        commands = after.command_at(composite_design(len(command)))
        statuses = self.nominal.evaluate(doubtful[:, None], commands).status
        return bool((statuses == StepStatus.OK).any(axis=1).all())


def searched_commands(settings: ControlSettings) -> int:
    """Number of commands that are searched if no better command is safe."""
    return min(SEARCH_POINTS, max(1, int(SEARCH_SHARE * settings.evaluations)))
