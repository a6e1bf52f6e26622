"""The limit cycles at the targets of a run, and what one step can reach: on the nominal and on the corrected map."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from stepgap.control.limit_cycle import FixedPoint, ReachableSet, fixed_point, reachable_set
from stepgap.learning.corrected_map import CorrectedMap
from stepgap.learning.observations import next_history
from stepgap.records.run_folder import RunRecord
from stepgap.report.html import table, with_unit
from stepgap.report.learnt import Learnt
from stepgap.step import Array, StepFailed, StepMap, StepSpace

MOST_GAITS: Final = 40
"""Targets of which limit cycles are sought."""


@dataclass(frozen=True, eq=False)
class MapGait:
    """What one map says of the targets.

    Attributes:
        name: Of the map.
        points: The limit cycle at each target, or what comes closest; None where no command makes a step.
        reachable: What one step from `ReferenceGait.centre` can reach.
    """

    name: str
    points: tuple[FixedPoint | None, ...]
    reachable: ReachableSet


@dataclass(frozen=True, eq=False)
class ReferenceGait:
    """Limit cycles at the targets of a run.

    Attributes:
        space: Of the maps.
        targets: Each different target once, in the order of the reference; shape (k, n).
        more: How many different targets are left out.
        centre: The target in the middle of them, where reachable sets begin; shape (n,).
        maps: The nominal map, and the corrected one if something was learnt.
    """

    space: StepSpace
    targets: Array
    more: int
    centre: Array
    maps: tuple[MapGait, ...]


def reference_gait(record: RunRecord, nominal: StepMap, learnt: Learnt | None) -> ReferenceGait:
    """Limit cycles at the targets of the last deployment shown.

    Args:
        record: The run.
        nominal: Map of the physics model.
        learnt: What is added to it.

    Raises:
        ValueError: The map is of another state or command than the run.
    """
    names = (nominal.space.state_names, nominal.space.command_names)
    if names != (record.space.state_names, record.space.command_names):
        raise ValueError(f"{record.folder}: the nominal map is of {names}, which is not the state and command of it")
    steps = record.steps.of_iteration(record.shown_iterations[-1]).tracking()
    distinct = list(dict.fromkeys(tuple(logged.target.tolist()) for logged in steps))
    targets = np.array(distinct[:MOST_GAITS])
    away = (targets - (targets.min(axis=0) + targets.max(axis=0)) / 2) / nominal.space.state_scale
    centre = targets[np.argmin(np.sum(away**2, axis=1))]
    maps = {"nominal": nominal}
    if learnt is not None:
        before = next_history(record.steps, nominal, learnt.iteration)
        maps["corrected"] = CorrectedMap(nominal, learnt.residual.conditioned_on(before))
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
    """Command and multipliers of the limit cycle at each target, map by map."""
    state, command = [[with_unit(each) for each in part] for part in (gait.space.state, gait.space.command)]
    heads = [*state, *(f"{each.name} {word}" for each in gait.maps for word in [*command, "λ", "gait"])]
    size, rows = len(command), []
    for row, target in enumerate(gait.targets):
        cells = [cell for each in gait.maps for cell in _cells(each.points[row], size)]
        rows.append([*(f"{value:.4g}" for value in target), *cells])
    return table(
        "Limit cycle at each target: the constant command that holds it, and the sizes |λ| of its multipliers",
        heads,
        rows,
    )


def gait_sentences(gait: ReferenceGait) -> list[str]:
    """Which targets are held, and whether they are stable."""
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
    """Command, multipliers and a word."""
    if point is None:
        return [*["–"] * (size + 1), "no step"]
    multipliers = ", ".join(f"{abs(value):.3f}" for value in point.floquet_multipliers)
    word = ("stable" if point.stable else "not stable") if point.held else "not held"
    return [*(f"{value:.2f}".replace("-", "−") for value in point.command), multipliers, word]
