"""Limit cycles at the targets of a run and one-step reachable sets, on the nominal and on the corrected map."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from stepgap.control.closed_loop import largest_multiplier, step_controller_gain
from stepgap.control.limit_cycle import FixedPoint, ReachableSet, fixed_point, reachable_set
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.gradient_samples import gradient_samples
from stepgap.learning.observations import next_history
from stepgap.learning.residual import join_points
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.learned import LearnedResidual
from stepgap.step import Array, StepFailed, StepMap, StepSpace

MOST_GAITS: Final = 40
"""Largest number of targets whose limit cycles are computed."""

GRADIENTS: Final = 400
"""Number of gradients of the learned residual that are drawn for an interval."""


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
    def has_closed_loop(self) -> bool:
        """Whether there is a corrected map, with whose step controller the closed loop was computed."""
        return any(each.multipliers for each in self.maps)


def reference_gait(record: RunRecord, nominal: StepMap, learned: LearnedResidual | Missing) -> ReferenceGait:
    """Computes the limit cycles at the targets of the last deployment.

    Args:
        record: The run.
        nominal: Map of the physics model.
        learned: Learned residual, which is added to the nominal map, or the reason why there is none.

    Raises:
        ValueError: The map has another state or command than the run.
    """
    if not nominal.space.has_names_of(record.space):
        names = nominal.space.state_names, nominal.space.command_names
        raise ValueError(f"{record.folder}: the nominal map has {names}, which differ from the run's state and command")
    steps = record.steps.of_iteration(record.shown_iterations[-1]).tracking()
    distinct = list(dict.fromkeys(tuple(logged.target.tolist()) for logged in steps))
    targets = np.array(distinct[:MOST_GAITS])
    centre = central_target(targets, nominal.space.state_scale)
    maps = {"nominal": nominal}
    if isinstance(learned, LearnedResidual):
        before = next_history(record.steps, nominal, learned.iteration)
        maps["corrected"] = CorrectedMap(nominal, learned.residual.conditioned_on(before))
    gaits = [_gait(name, step_map, targets, centre) for name, step_map in maps.items()]
    return ReferenceGait(nominal.space, targets, len(distinct) - len(targets), centre, tuple(gaits))


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
        (row, *_) = np.flatnonzero((gait.targets == gait.centre).all(axis=1))
        point = gait.maps[-1].points[row]
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
