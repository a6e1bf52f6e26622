"""Limit cycles at the targets of a run and one-step reachable sets, on the nominal and on the corrected map."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from stepgap.control.limit_cycle import FixedPoint, ReachableSet, fixed_point, reachable_set
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import next_history
from stepgap.records.run_folder import RunRecord
from stepgap.report.html import table, with_unit
from stepgap.report.learned import LearnedResidual
from stepgap.step import Array, StepFailed, StepMap, StepSpace

MOST_GAITS: Final = 40
"""Largest number of targets whose limit cycles are computed."""


@dataclass(frozen=True, eq=False)
class MapGait:
    """Limit cycles and reachable set of one map.

    Attributes:
        name: Name of the map.
        points: Limit cycle at each target, or the closest point; None where no command makes a step.
        reachable: One-step reachable set from `ReferenceGait.centre`.
    """

    name: str
    points: tuple[FixedPoint | None, ...]
    reachable: ReachableSet


@dataclass(frozen=True, eq=False)
class ReferenceGait:
    """Limit cycles at the targets of a run.

    Attributes:
        space: State and command of the maps.
        targets: Distinct targets in the order of the reference; shape (k, n).
        more: Number of distinct targets that are left out.
        centre: Target in the middle of all, from which the reachable sets start; shape (n,).
        maps: Nominal map and, if there is a learned residual, corrected map.
    """

    space: StepSpace
    targets: Array
    more: int
    centre: Array
    maps: tuple[MapGait, ...]


def reference_gait(record: RunRecord, nominal: StepMap, learned: LearnedResidual | None) -> ReferenceGait:
    """Computes the limit cycles at the targets of the last deployment.

    Args:
        record: The run.
        nominal: Map of the physics model.
        learned: Learned residual, which is added to the nominal map.

    Raises:
        ValueError: The map has another state or command than the run.
    """
    if not nominal.space.has_names_of(record.space):
        names = nominal.space.state_names, nominal.space.command_names
        raise ValueError(f"{record.folder}: the nominal map has {names}, which differ from the run's state and command")
    steps = record.steps.of_iteration(record.shown_iterations[-1]).tracking()
    distinct = list(dict.fromkeys(tuple(logged.target.tolist()) for logged in steps))
    targets = np.array(distinct[:MOST_GAITS])
    away = (targets - (targets.min(axis=0) + targets.max(axis=0)) / 2) / nominal.space.state_scale
    centre = targets[np.argmin(np.sum(away**2, axis=1))]
    maps = {"nominal": nominal}
    if learned is not None:
        before = next_history(record.steps, nominal, learned.iteration)
        maps["corrected"] = CorrectedMap(nominal, learned.residual.conditioned_on(before))
    gaits = [_gait(name, step_map, targets, centre) for name, step_map in maps.items()]
    return ReferenceGait(nominal.space, targets, len(distinct) - len(targets), centre, tuple(gaits))


def _gait(name: str, step_map: StepMap, targets: Array, centre: Array) -> MapGait:
    points, guess = [], None
    for target in targets:
        try:
            points.append(fixed_point(step_map, target, guess))
            guess = points[-1].command
        except StepFailed:
            points.append(None)
    return MapGait(name, tuple(points), reachable_set(step_map, centre))


def gait_table(gait: ReferenceGait) -> str:
    """Table of command and Floquet multipliers of the limit cycle at each target, map by map."""
    state, command = [[with_unit(each) for each in part] for part in (gait.space.state, gait.space.command)]
    heads = [*state, *(f"{each.name} {word}" for each in gait.maps for word in [*command, "λ", "gait"])]
    size, rows = len(command), []
    for row, target in enumerate(gait.targets):
        cells = [cell for each in gait.maps for cell in _cells(each.points[row], size)]
        rows.append([*(f"{value:.4g}" for value in target), *cells])
    return table(
        "Limit cycle at each target: the constant command that holds it, and the magnitudes |λ| of its Floquet "
        "multipliers",
        heads,
        rows,
    )


def gait_sentences(gait: ReferenceGait) -> list[str]:
    """Sentences on which targets are held and which limit cycles are stable."""
    found = []
    for each in gait.maps:
        held = [point for point in each.points if point is not None and point.held]
        stable = sum(point.stable for point in held)
        found.append(
            f"{each.name.capitalize()} map: {len(held)} of {len(each.points)} targets are held by a constant command "
            f"within its bounds; {stable} of these limit cycles are stable at that command (all |λ| < 1)."
        )
    if gait.more:
        found.append(f"The other {gait.more} targets are left out.")
    return found


def _cells(point: FixedPoint | None, size: int) -> list[str]:
    """Cells with command, multipliers and verdict."""
    if point is None:
        return [*["–"] * (size + 1), "no step"]
    multipliers = ", ".join(f"{abs(value):.3f}" for value in point.floquet_multipliers)
    verdict = ("stable" if point.stable else "not stable") if point.held else "not held"
    return [*(f"{value:.2f}".replace("-", "−") for value in point.command), multipliers, verdict]
