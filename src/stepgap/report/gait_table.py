"""Limit cycles at the targets of a run, and their stability in open and closed loop, in a table and in sentences."""

from collections.abc import Sequence

import numpy as np

from stepgap.control.limit_cycle import FixedPoint
from stepgap.records.text import between, decimal, in_scale, trimmed, with_unit
from stepgap.report.html import table
from stepgap.report.measured_loop import MeasuredLoop
from stepgap.report.reference_gait import MapGait, ReferenceGait
from stepgap.step import Array, StepSpace


def measured_sentences(loops: Sequence[MeasuredLoop | None]) -> list[str]:
    """Sentence on the measured stability of the closed loop in the last deployment; empty if it is not known."""
    found = loops[-1] if loops else None
    if found is None:
        return []
    verdict = {
        "decays": "so errors decay from step to step",
        "grows": "so errors grow from step to step",
        "not decided": "so these steps do not show whether errors decay",
    }[_verdict(found.interval)]
    return [
        f"Measured stability with the step controller of deployment {found.iteration}: the largest Floquet multiplier "
        f"is {decimal(found.largest, 2)}{between(found.interval, digits=2)} in magnitude, from {found.steps} steps at "
        f"unchanged targets, {verdict}."
    ]


def growth_sentences(loops: Sequence[MeasuredLoop | None]) -> list[str]:
    """The sentence of `measured_sentences` if errors grow, which is unusual; else none."""
    found = loops[-1] if loops else None
    return measured_sentences(loops) if found is not None and _verdict(found.interval) == "grows" else []


def measured_table(loops: Sequence[MeasuredLoop | None]) -> str:
    """Table of the measured multipliers of the closed loop by deployment; empty if none is known."""
    rows = [_measured_row(each) for each in loops if each is not None]
    if not rows:
        return ""
    return table(
        "Closed loop, measured: largest magnitude |λ| of the Floquet multipliers with the step controller as deployed, "
        "from the errors of consecutive states at unchanged targets",
        ["deployment", "steps", "largest |λ|", "95 % interval", "an error"],
        rows,
    )


def _measured_row(found: MeasuredLoop) -> list[str]:
    ends = _interval(found.interval)
    return [str(found.iteration), str(found.steps), decimal(found.largest, 2), ends, _verdict(found.interval)]


def gait_table(gait: ReferenceGait) -> str:
    """Table of command and Floquet multipliers of the limit cycle at each target, map by map."""
    tracked = np.flatnonzero(np.isfinite(gait.targets).any(axis=0)).tolist()
    state = [gait.space.state[row] for row in tracked]
    command = [with_unit(each) for each in gait.space.command]
    heads = [with_unit(each) for each in state]
    for each in gait.maps:
        heads += [f"{each.name} {name}" for name in [*command, "open-loop |λ|"]]
    rows = [
        [
            *(trimmed(in_scale(value, one)) for value, one in zip(target[tracked], state, strict=True)),
            *(cell for each in gait.maps for cell in _cells(each, row, gait.space)),
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
    found = []
    for each in gait.maps:
        held = [point for point in each.points if point is not None and point.held]
        found.append(
            f"{each.name.capitalize()} map: {len(held)} of {_count(each)} held by a constant command within "
            f"its bounds, up to the noise of one step.{_open_loop(held) if held else ''}"
        )
    if gait.more:
        found.append(f"The other {gait.more} targets are left out.")
    return found


def _count(gait: MapGait) -> str:
    """Number of targets with its verb."""
    count = len(gait.points)
    return f"{count} target{'s are' if count > 1 else ' is'}"


def _open_loop(held: Sequence[FixedPoint]) -> str:
    """Sentence on the stability at constant commands."""
    known = [point for point in held if np.isfinite(point.floquet_multipliers).all()]
    stable = sum(point.stable for point in known)
    unknown = f", and at {len(held) - len(known)} it is not known" if len(known) < len(held) else ""
    return (
        " Without the step controller, at this constant command (open loop), an error of the state decays at "
        f"{stable} of them and grows at {len(known) - stable}{unknown}, by the map."
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
