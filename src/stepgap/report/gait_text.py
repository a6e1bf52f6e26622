"""The gait of a run in tables and sentences: limit cycles at its targets, their stability, and what commands can do."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from stepgap.control.limit_cycle import FixedPoint
from stepgap.control.reach import SMALL_PART, CommandEffect
from stepgap.records.text import between, capitalised, decimal, in_scale, in_words, listed, trimmed, with_unit
from stepgap.report.html import table
from stepgap.report.measured_loop import MeasuredLoop
from stepgap.report.reference_gait import MapGait, ReferenceGait
from stepgap.step import Array, StepSpace


def measured_sentences(loops: Sequence[MeasuredLoop | None]) -> list[str]:
    """Sentence on the measured stability of the closed loop in the last deployment; empty if it is not known."""
    loop = loops[-1] if loops else None
    if loop is None:
        return []
    verdict = {
        "decays": "so errors decay from step to step",
        "grows": "so errors grow from step to step",
        "not decided": "so these steps do not show whether errors decay",
    }[_verdict(loop.interval)]
    return [
        f"Measured stability with the step controller of deployment {loop.iteration}: the largest Floquet multiplier "
        f"is {decimal(loop.largest, 2)}{between(loop.interval, digits=2)} in magnitude, from {loop.steps} steps at "
        f"unchanged targets, {verdict}."
    ]


def growth_sentences(loops: Sequence[MeasuredLoop | None]) -> list[str]:
    """The sentence of `measured_sentences` if errors grow, which is unusual; else none."""
    grows = bool(loops) and loops[-1] is not None and _verdict(loops[-1].interval) == "grows"
    return measured_sentences(loops) if grows else []


def measured_table(loops: Sequence[MeasuredLoop | None]) -> str:
    """Table of the measured multipliers of the closed loop by deployment; empty if none is known."""
    rows = []
    for loop in filter(None, loops):
        size = decimal(loop.largest, 2)
        rows.append([str(loop.iteration), str(loop.steps), size, _interval(loop.interval), _verdict(loop.interval)])
    if not rows:
        return ""
    return table(
        "Closed loop, measured: largest magnitude |λ| of the Floquet multipliers with the step controller as deployed, "
        "from the errors of consecutive states at unchanged targets",
        ["deployment", "steps", "largest |λ|", "95 % interval", "an error"],
        rows,
    )


def gait_table(gait: ReferenceGait) -> str:
    """Table of command and Floquet multipliers of the limit cycle at each target, map by map."""
    tracked = np.flatnonzero(np.isfinite(gait.targets).any(axis=0)).tolist()
    state = [gait.space.state[row] for row in tracked]
    command = [with_unit(quantity) for quantity in gait.space.command]
    heads = [with_unit(quantity) for quantity in state]
    for cycles in gait.maps:
        heads += [f"{cycles.name} {name}" for name in [*command, "open-loop |λ|"]]
    rows = [
        [
            *(trimmed(in_scale(value, one)) for value, one in zip(target[tracked], state, strict=True)),
            *(cell for cycles in gait.maps for cell in _cells(cycles, row, gait.space)),
        ]
        for row, target in enumerate(gait.targets)
    ]
    caption = (
        "Limit cycle at each target: the constant command that holds it, and the magnitudes |λ| of its Floquet "
        "multipliers: open loop, at this constant command"
    )
    return table(caption, heads, rows)


def gait_sentences(gait: ReferenceGait) -> list[str]:
    """Sentences on which targets are held, and on the stability of their limit cycles."""
    lines = []
    for cycles in gait.maps:
        held = [point for point in cycles.points if point is not None and point.held]
        lines.append(
            f"{cycles.name.capitalize()} map: {len(held)} of {_count(cycles)} held by a constant command within "
            f"its bounds, up to the noise of one step.{_open_loop(held) if held else ''}"
        )
    if gait.more:
        lines.append(f"The other {gait.more} targets are left out.")
    return lines


def _count(gait: MapGait) -> str:
    """Number of targets with its verb."""
    count = len(gait.points)
    return f"{count} target{'s are' if count > 1 else ' is'}"


def _open_loop(held: Sequence[FixedPoint]) -> str:
    """Sentence on the stability at constant commands."""
    points = [point for point in held if np.isfinite(point.floquet_multipliers).all()]
    stable = sum(point.stable for point in points)
    unknown = f", and at {len(held) - len(points)} it is not known" if len(points) < len(held) else ""
    return (
        " Without the step controller, at this constant command (open loop), an error of the state decays at "
        f"{stable} of them and grows at {len(points) - stable}{unknown}, by the map."
    )


def _verdict(ends: Array) -> str:
    """What an interval of the largest multiplier says about an error."""
    if ends[1] < 1:
        return "decays"
    return "grows" if ends[0] > 1 else "not decided"


def _cells(gait: MapGait, row: int, space: StepSpace) -> list[str]:
    """Cells of a map at one target: command and multipliers."""
    point = gait.points[row]
    size = len(space.command)
    if point is None:
        return [*["–"] * size, "no step"]
    multipliers = ", ".join(decimal(abs(value)) for value in point.floquet_multipliers) if point.held else "not held"
    command = (in_scale(value, one) for value, one in zip(point.command, space.command, strict=True))
    return [*command, multipliers]


def _interval(ends: Array) -> str:
    return f"{ends[0]:.2f} … {ends[1]:.2f}" if np.isfinite(ends).all() else "–"


HALF_RANGES: Final = "half ranges of use"


def reach_sentences(gait: ReferenceGait) -> list[str]:
    """Sentences on the commands by the last map, which is the corrected one if there is one."""
    last = gait.maps[-1]
    unit = "noise floors" if gait.has_floor else HALF_RANGES
    lines = [] if last.effect is None else effect_sentences(gait.space, last.effect, f"the {last.name} map", unit)
    return [*lines, *_changes(gait, last)]


def effect_sentences(space: StepSpace, effect: CommandEffect, by_map: str, unit: str) -> list[str]:
    """Sentences on the rank of the commands' effect, and on their delays.

    Args:
        by_map: The map, in the middle of a sentence.
        unit: The unit of the effect, in the plural; `HALF_RANGES` for that of `SMALL_PART` of them.
    """
    n = len(space.state)
    rank = effect.rank
    tracked = [quantity.name for quantity in space.state if quantity.weight]
    sizes = [decimal(size * (SMALL_PART if unit == HALF_RANGES else 1.0), 2) for size in effect.sizes]
    weakest = f" in the strongest one and {sizes[-1]} in the weakest" if len(sizes) > 1 else ""
    directions = f"{rank or 'no'} independent direction{'' if rank == 1 else 's'}"
    few = (
        f". So one step does not reach every combination of {listed(tracked)}, even if it reaches each one"
        if rank < len(tracked)
        else ""
    )
    lines = [
        f"By {by_map}, the commands move the next state in {directions} (from one end of their bounds to the other, by "
        f"{sizes[0]} {unit}{weakest}){few}."
    ]
    late = {steps: [] for steps in sorted(set(effect.delays.tolist()) - {1})}
    for name, steps in zip(space.state_names, effect.delays.tolist(), strict=True):
        if steps != 1:
            late[steps].append(name)
    for steps, names in late.items():
        verb = "moves" if len(names) == 1 else "move"
        lines.append(
            f"By {by_map}, no command moves {listed(names, 'or')} within {n} step{'s' * (n > 1)}."
            if steps == 0
            else f"By {by_map}, {listed(names)} {verb} only {steps} steps after a command begins."
        )
    return lines


def _changes(gait: ReferenceGait, last: MapGait) -> list[str]:
    """Sentence on the changes of the target that one step can make."""
    count = len(gait.changes)
    reached = int(np.count_nonzero(last.changes))
    if not count:
        return []
    if reached == count:
        which = "the change" if count == 1 else f"each of the {count} changes"
        return [f"By the {last.name} map, one step can make {which} of the target."]
    before, after = (in_words(gait.space.state, target) for target in gait.changes[np.argmin(last.changes)])
    return [
        capitalised(
            f"by the {last.name} map, one step can make {reached or 'none'} of the {count} changes of the target, for "
            f"example not that from {before} to {after}: such changes take several steps, or cannot be made."
        )
    ]
