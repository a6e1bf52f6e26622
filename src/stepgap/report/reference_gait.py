"""The limit cycles at the targets of a run, and what commands can do there, by the nominal and the corrected map."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from stepgap.base.errors import InputError
from stepgap.control.gauss_newton import REACHED
from stepgap.control.limit_cycle import FixedPoint, ReachableSet, fixed_point, reachable_set, reached_in_one_step
from stepgap.control.reach import SMALL_PART, CommandEffect, command_effect, whole_states
from stepgap.control.reference import distinct_rows, same_target
from stepgap.experiment.run import Run
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import next_history
from stepgap.records.missing import Missing
from stepgap.records.text import in_words
from stepgap.report.learned_residual import LearnedResidual, steps_before
from stepgap.step import Array, StepFailed, StepMap, StepSpace

MOST_GAITS: Final = 40  # Largest number of targets whose limit cycles are computed


@dataclass(frozen=True, eq=False)
class MapGait:
    """Limit cycles and reachable set of one map.

    Attributes:
        name: Name of the map.
        points: Limit cycle at each target, or the closest point; None where no command makes a step.
        reachable: One-step reachable set from `ReferenceGait.centre`.
        changes: Whether one step leads from one target to the next one, by `ReferenceGait.changes`; shape (c,).
        effect: Effect of the commands at the points, in `ReferenceGait.unit`; None if no command makes a step.
    """

    name: str
    points: tuple[FixedPoint | None, ...]
    reachable: ReachableSet
    changes: NDArray[np.bool_]
    effect: CommandEffect | None


@dataclass(frozen=True, eq=False)
class ReferenceGait:
    """Limit cycles at the targets of a run.

    Attributes:
        space: State and command of the maps.
        targets: Distinct targets in the order of the reference; shape (k, n).
        more: Number of distinct targets that are left out.
        centre: Target nearest to the median of all, from which the reachable sets start; shape (n,).
        changes: Distinct pairs of consecutive targets that differ, at most `MOST_GAITS`; shape (c, 2, n).
        unit: What counts as a change of each coordinate: its noise floor, or a part of its range of use; shape (n,).
        has_floor: Whether the unit is the noise floor.
        maps: Nominal map and, if there is a learned residual, corrected map.
    """

    space: StepSpace
    targets: Array
    more: int
    centre: Array
    changes: Array
    unit: Array
    has_floor: bool
    maps: tuple[MapGait, ...]

    @property
    def centre_named(self) -> str:
        """The target from which the reachable sets start, with names and units."""
        return in_words(self.space.state, self.centre)

    @property
    def centre_point(self) -> FixedPoint | None:
        """Limit cycle at the target `centre` on the last map, or the closest point; None if no command makes a step."""
        (row, *_) = np.flatnonzero(same_target(self.targets, self.centre))
        return self.maps[-1].points[row]


def reference_gait(run: Run, nominal: StepMap, learned: LearnedResidual | Missing) -> ReferenceGait:
    """Computes the limit cycles at the targets of the last deployment.

    Args:
        learned: Learned residual, which is added to the nominal map, or the reason why there is none.

    Raises:
        InputError: The map has another state or command than the run.
    """
    if not nominal.space.has_names_of(run.space):
        names = nominal.space.state_names, nominal.space.command_names
        raise InputError(f"{run.folder}: the nominal map has {names}, which differ from the run's state and command")
    steps = run.steps.of_iteration(run.shown_iterations[-1]).tracking()
    distinct = _distinct(steps.target[np.isfinite(steps.target).any(axis=1)])
    targets = distinct[:MOST_GAITS]
    centre = central_target(targets, nominal.space.state_scale)
    maps = {"nominal": nominal}
    if isinstance(learned, LearnedResidual):
        before = next_history(steps_before(run, learned.iteration), nominal.space, learned.iteration)
        maps["corrected"] = CorrectedMap(nominal, learned.residual.conditioned_on(before))
    unit, has_floor = effect_unit(run)
    changes = _changes(steps.target)
    gaits = [_gait(name, step_map, targets, centre, changes, unit) for name, step_map in maps.items()]
    more = len(distinct) - len(targets)
    return ReferenceGait(nominal.space, targets, more, centre, changes, unit, has_floor, tuple(gaits))


def effect_unit(run: Run) -> tuple[Array, bool]:
    """What counts as a change of each coordinate (n,), and whether it is the noise floor, which every one must have."""
    small = SMALL_PART * run.space.state_scale
    if (run.noise_floor > REACHED * run.space.state_scale).all():
        return run.noise_floor, True
    return small, False


def _changes(targets: Array) -> Array:
    """Distinct pairs of consecutive targets (N, n) that differ; shape (c, 2, n)."""
    pairs = np.stack([targets[:-1], targets[1:]], axis=1)
    changed = ~same_target(pairs[:, 0], pairs[:, 1]) & np.isfinite(pairs[:, 1]).any(axis=1)
    changing = pairs[changed].reshape(-1, 2 * targets.shape[1])
    return _distinct(changing)[:MOST_GAITS].reshape(-1, 2, targets.shape[1])


def _distinct(rows: Array) -> Array:
    """Distinct rows in their order; (N, k) to (d, k)."""
    return rows[np.sort(distinct_rows(rows)[0])]


def central_target(targets: Array, scale: Array) -> Array:
    """The target nearest to the median of all, which a single target far from the others hardly moves; shape (n,).

    It is one of those that want most.

    Args:
        targets: Distinct targets; shape (k, n).
        scale: Half range of each coordinate; shape (n,).
    """
    tracked = np.isfinite(targets).any(axis=0)
    away = (targets[:, tracked] - np.nanmedian(targets[:, tracked], axis=0)) / scale[tracked]
    missing = np.isnan(away).sum(axis=1)
    return targets[np.argmin(np.where(missing == missing.min(), np.nansum(away**2, axis=1), np.inf))]


def _gait(name: str, step_map: StepMap, targets: Array, centre: Array, changes: Array, unit: Array) -> MapGait:
    points = list[FixedPoint | None]()
    guess = None
    for target in targets:
        try:
            point = fixed_point(step_map, target, guess)
            guess = point.command
        except StepFailed:
            point = None
        points.append(point)
    reached = reached_in_one_step(step_map, whole_states(step_map, changes[:, 0]), changes[:, 1])
    (start,) = whole_states(step_map, centre[None])
    return MapGait(name, tuple(points), reachable_set(step_map, start), reached, _effect(step_map, points, unit))


def _effect(step_map: StepMap, points: Sequence[FixedPoint | None], unit: Array) -> CommandEffect | None:
    """Effect of the commands, by the median of the derivatives at some points."""
    jacobians = [step_map.jacobian(point.state, point.command) for point in points if point is not None]
    finite = [jacobian for jacobian in jacobians if np.isfinite(jacobian).all()]
    return command_effect(step_map.space, np.median(finite, axis=0), unit) if finite else None
