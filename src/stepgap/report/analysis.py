"""What a report computes from a run: its learned residual, its limit cycles and its measured closed loops.

The limit cycles at the targets and the one-step reachable sets are those of the nominal and of the corrected map.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, final

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.closed_loop import largest_multiplier, step_controller_gain
from stepgap.control.limit_cycle import FixedPoint, ReachableSet, fixed_point, reachable_set
from stepgap.experiment.run import Run
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.disturbance import without_periodic_part
from stepgap.learning.gradient_samples import gradient_samples
from stepgap.learning.observations import next_history, observe
from stepgap.learning.regression import Prediction
from stepgap.learning.residual import HistoryInputs, Residual, join_points
from stepgap.learning.steps import Steps
from stepgap.records.missing import Missing
from stepgap.records.motion_file import Replay
from stepgap.report.measured_loop import MeasuredLoop, measured_loop
from stepgap.report.text import in_words
from stepgap.step import Array, Quantity, StepFailed, StepMap, StepSpace

MOST_GAITS: Final = 40
"""Largest number of targets whose limit cycles are computed."""

GRADIENTS: Final = 400
"""Number of gradients of the learned residual that are drawn for an interval."""


@dataclass(frozen=True, eq=False)
class LearnedResidual:
    """A residual, which was fitted to the steps of earlier deployments, and the deployment that begins with it.

    Attributes:
        iteration: Number of the deployment; after an online run that of the next one, which was not executed.
        residual: Residual at the start of the deployment.
    """

    iteration: int
    residual: Residual

    @property
    def steps(self) -> int:
        """Number of steps to which the residual was fitted; 0 for a residual that does not keep them."""
        return len(self.residual.regressions[0].values)

    @cached_property
    def leave_one_out(self) -> list[Prediction]:
        """Predictions by each regression of each of its N values from all others."""
        singles = [slice(row, row + 1) for row in range(self.steps)]
        return [regression.left_out(singles) for regression in self.residual.regressions]

    @property
    def standardised_errors(self) -> list[Array]:
        """Differences of the values from their leave-one-out predictions, in standard deviations; shapes (N,)."""
        pairs = zip(self.residual.regressions, self.leave_one_out, strict=True)
        return [(regression.values - predicted.mean) / predicted.std for regression, predicted in pairs]


@dataclass(frozen=True, eq=False)
class Multipliers:
    """Largest magnitudes of the Floquet multipliers that the data of the learned residual leave possible.

    Each row belongs to a target and has the 2.5, 50 and 97.5 % quantiles, NaN where the target is not held.

    Attributes:
        open_loop: At the constant command of the limit cycle; shape (k, 3).
        closed_loop: With the step controller of the corrected map, if the gradient of the robot's map is not that of
            the corrected map but another possible one; shape (k, 3).
    """

    open_loop: Array
    closed_loop: Array


@dataclass(frozen=True, eq=False)
class MapGait:
    """Limit cycles and reachable set of one map.

    Attributes:
        name: Name of the map.
        points: Limit cycle at each target, or the closest point; None where no command makes a step.
        reachable: One-step reachable set from `ReferenceGait.centre`.
        multipliers: Their possible magnitudes by the uncertainty of the map; None for the nominal map, which has none.
    """

    name: str
    points: tuple[FixedPoint | None, ...]
    reachable: ReachableSet
    multipliers: Multipliers | None = None


@dataclass(frozen=True, eq=False)
class ReferenceGait:
    """Limit cycles at the targets of a run.

    Attributes:
        space: State and command of the maps.
        targets: Distinct targets in the order of the reference; shape (k, n).
        more: Number of distinct targets that are left out.
        centre: Target nearest to the median of all, from which the reachable sets start; shape (n,).
        maps: Nominal map and, if there is a learned residual, corrected map.
    """

    space: StepSpace
    targets: Array
    more: int
    centre: Array
    maps: tuple[MapGait, ...]

    @property
    def centre_named(self) -> str:
        """The target from which the reachable sets start, with names and units."""
        return in_words(self.space.state, self.centre)

    @property
    def centre_point(self) -> FixedPoint | None:
        """Limit cycle at the target `centre` on the last map, or the closest point; None if no command makes a step."""
        (row, *_) = np.flatnonzero((self.targets == self.centre).all(axis=1))
        return self.maps[-1].points[row]

    @property
    def has_closed_loop(self) -> bool:
        """Whether there is a corrected map, with whose step controller the closed loop was computed."""
        return any(each.multipliers for each in self.maps)


@final
@dataclass(frozen=True, eq=False)
class Analysis:
    """What a report computes from a run, each part when it is first used.

    Attributes:
        run: The run, which has at least one step.
    """

    run: Run

    @cached_property
    def learned(self) -> LearnedResidual | Missing:
        """The residual with which the last deployment began.

        If that is deployment 0, and it learned from the nominal map on, it is the residual fitted afterwards to all
        steps.
        """
        if not self.run.has_unsaved_residual:
            last = self.run.shown_iterations[-1]
            residual = self.run.residual(last)
            return residual if isinstance(residual, Missing) else LearnedResidual(last, residual)
        final = self.run.final
        if isinstance(final, Missing):
            return Missing(f"deployment 0 learned while it ran, so no model was saved before it, and {final.reason}")
        return LearnedResidual(1, final)

    @cached_property
    def removed_periodic_part(self) -> Array:
        """RMS of what was removed from the errors before the residual was fitted, because it returned with the phase.

        Shape (n,); zero where nothing was removed, or if it is not known.
        """
        run, settings, nominal, learned = self.run, self.run.settings, self.run.nominal, self.learned
        nothing = np.zeros(len(run.space.state))
        if isinstance(settings, Missing) or isinstance(nominal, Missing) or isinstance(learned, Missing):
            return nothing
        if not settings.learning.remove_yaw_dependence or not learned.steps:
            return nothing
        try:
            log = Steps(run.steps.space) + run.known + run.steps.before(learned.iteration)
        except InputError:  # the steps that were known before this run are lost
            return nothing
        seen = observe(log, nominal)
        change = seen.error - without_periodic_part(seen, learned.iteration).error
        return np.sqrt(np.mean(change**2, axis=0))

    @property
    def has_learned_steps(self) -> bool:
        """Whether the learned residual is known and keeps the steps to which it was fitted."""
        return not isinstance(self.learned, Missing) and self.learned.steps > 0

    @cached_property
    def replay(self) -> Replay | Missing:
        """Motions of the first and of the last deployment; they are kept in `replay/` of the folder."""
        from stepgap.experiment.replay import replay_of  # only where it is used: it imports plants

        return replay_of(self.run)

    @cached_property
    def gait(self) -> ReferenceGait | Missing:
        """Limit cycles at the targets of the last deployment.

        Raises:
            InputError: The nominal map has another state or command than the run.
        """
        if isinstance(self.run.nominal, Missing):
            return self.run.nominal
        if not len(self.run.steps.of_iteration(self.run.shown_iterations[-1]).tracking()):
            return Missing("no target was tracked yet")
        return reference_gait(self.run, self.run.nominal, self.learned)

    @cached_property
    def loops(self) -> list[MeasuredLoop | None]:
        """The measured closed loop of each finished deployment; None where it is not known."""
        return [measured_loop(self.run.steps.of_iteration(each.iteration)) for each in self.run.deployments]


def reference_gait(run: Run, nominal: StepMap, learned: LearnedResidual | Missing) -> ReferenceGait:
    """Computes the limit cycles at the targets of the last deployment.

    Args:
        run: The run.
        nominal: Map of the physics model.
        learned: Learned residual, which is added to the nominal map, or the reason why there is none.

    Raises:
        InputError: The map has another state or command than the run.
    """
    if not nominal.space.has_names_of(run.space):
        names = nominal.space.state_names, nominal.space.command_names
        raise InputError(f"{run.folder}: the nominal map has {names}, which differ from the run's state and command")
    steps = run.steps.of_iteration(run.shown_iterations[-1]).tracking()
    distinct = list(dict.fromkeys(tuple(logged.target.tolist()) for logged in steps))
    targets = np.array(distinct[:MOST_GAITS])
    centre = central_target(targets, nominal.space.state_scale)
    maps = {"nominal": nominal}
    if isinstance(learned, LearnedResidual):
        before = next_history(run.steps, nominal, learned.iteration)
        maps["corrected"] = CorrectedMap(nominal, learned.residual.conditioned_on(before))
    gaits = [_gait(name, step_map, targets, centre) for name, step_map in maps.items()]
    return ReferenceGait(nominal.space, targets, len(distinct) - len(targets), centre, tuple(gaits))


def input_quantities(space: StepSpace, history_inputs: HistoryInputs) -> list[Quantity]:
    """Names and units of a residual's inputs; those of the previous step are normalised by half their range."""
    previous = [Quantity(f"previous_error_of_{each.name}", "half ranges", -1, 1) for each in space.state]
    if history_inputs.lagged_inputs == "previous_step":
        previous += [Quantity(f"previous_{each.name}", "half ranges", -1, 1) for each in (*space.command, *space.state)]
    elif history_inputs.lagged_inputs == "none":
        previous = []
    time = [Quantity("time", "forgetting times", -1, 1)] if history_inputs.timed else []
    return [*space.state, *space.command, *previous, *time]


def central_target(targets: Array, scale: Array) -> Array:
    """The target nearest to the median of all, which a single target far from the others hardly moves; shape (n,).

    Args:
        targets: Distinct targets; shape (k, n).
        scale: Half range of each coordinate; shape (n,).
    """
    away = (targets - np.median(targets, axis=0)) / scale
    return targets[np.argmin(np.sum(away**2, axis=1))]


def centre_of(learned: LearnedResidual, gait: object) -> Array:
    """State and command of the limit cycle on the corrected map at the central target; shape (n + m,).

    If the gait is not known, it is the median of the points to which the residual was fitted.

    Args:
        learned: The residual.
        gait: A `ReferenceGait`, or anything else if it is not known.
    """
    n, m = learned.residual.sizes
    if isinstance(gait, ReferenceGait):
        point = gait.centre_point
        if point is not None:
            return join_points(point.state, point.command)
    return np.median(learned.residual.regressions[0].points[:, : n + m], axis=0)


def _gait(name: str, step_map: StepMap, targets: Array, centre: Array) -> MapGait:
    points, guess = [], None
    for target in targets:
        try:
            points.append(fixed_point(step_map, target, guess))
            guess = points[-1].command
        except StepFailed:
            points.append(None)
    possible = _multipliers(step_map, points) if isinstance(step_map, CorrectedMap) else None
    return MapGait(name, tuple(points), reachable_set(step_map, centre), possible)


def _multipliers(step_map: CorrectedMap, points: Sequence[FixedPoint | None]) -> Multipliers:
    """Multipliers for gradients of the residual drawn from its posterior, with a fixed seed."""
    space, rng = step_map.space, np.random.default_rng(0)
    scale = np.concatenate([space.state_scale, space.command_scale])
    found = np.full((2, len(points), 3), np.nan)
    for row, point in enumerate(points):
        if point is not None and point.held:
            at = join_points(point.state, point.command)
            learned = gradient_samples(step_map.residual, at, scale, GRADIENTS, rng)
            jacobians = step_map.nominal.jacobian(point.state, point.command) + learned
            gain = step_controller_gain(step_map, point)
            drawn = largest_multiplier(jacobians), largest_multiplier(jacobians, gain)
            found[:, row] = np.percentile(drawn, [2.5, 50, 97.5], axis=1).T
    return Multipliers(*found)
