"""What else could be the step command of a robot, as text and as a figure, for `stepgap gait knobs`."""

from typing import TYPE_CHECKING

import numpy as np

from stepgap.experiment.knobs import KnobPair, KnobStudy, largest_effect
from stepgap.records.text import decimal, in_scale, trimmed, unit_suffix
from stepgap.report.drawing import axis_label, new_figure

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

SHOWN_PAIRS = 12
"""Number of pairs in the table; the others change the state in nearly one direction, or hardly."""


def describe_knobs(study: KnobStudy) -> str:
    """Tables of the effects of all knobs, the strongest first, and of the best pairs, for the terminal."""
    space, names = study.space, [each.key for each in study.knobs]
    tracked = np.flatnonzero(space.tracked)
    left_out = f"; {study.left_out} other states are not held" if study.left_out else ""
    lines = [
        f"{len(study.states)} gaits all over the ranges of use{left_out}. Change of the next state by the whole "
        "range of a setting: mean (least … largest)"
    ]
    rows = [["setting", "range ±", *(f"{space.state[row].name}{unit_suffix(space.state[row])}" for row in tracked)]]
    for number in np.argsort(-largest_effect(study)):
        knob, cells = study.knobs[number], []
        for row in tracked:
            values, one = study.effects[:, row, number], space.state[row]
            mean, least, most = (
                trimmed(in_scale(each, one, 3)) for each in (values.mean(), values.min(), values.max())
            )
            cells.append(f"{mean} ({least} … {most})")
        rows.append([knob.key, f"{decimal(knob.reach)} {knob.unit}".strip(), *cells])
    lines += _aligned(rows)
    if study.failed:
        names_of_failed = ", ".join(each.key for each in study.failed)
        lines.append(f"left out, since a tenth of the range is not valid, or a step fails with it: {names_of_failed}")
    if not study.pairs:
        return "\n".join(lines)
    lines += [
        "",
        "Pairs as the whole step command, the best balanced first; loads of gaits and of steps by a quarter of a range",
    ]
    pairs = study.pairs[:SHOWN_PAIRS]
    own = [each for each in study.pairs if {names[each.first], names[each.second]} <= set(space.command_names)]
    pairs += tuple(each for each in own if each not in pairs)
    loads = list(max((each.loads for each in study.pairs), key=len))  # empty for a pair that makes no wanted step
    head = ["pair", "angle", "condition", "out of range", *(f"largest {name}" for name in loads)]
    return "\n".join([*lines, *_aligned([head, *(_pair_row(study, each, loads) for each in pairs)])])


def _pair_row(study: KnobStudy, pair: KnobPair, loads: list[str]) -> list[str]:
    name = f"{study.knobs[pair.first].key}, {study.knobs[pair.second].key}"
    numbers = [f"{np.degrees(pair.angle):.0f}°", decimal(pair.condition, 2)]
    numbers.append(f"{pair.missed:.0%}" if np.isfinite(pair.missed) else "–")
    return [name, *numbers, *(decimal(pair.loads.get(each, np.nan)) for each in loads)]


def _aligned(rows: list[list[str]]) -> list[str]:
    """Rows as lines with columns of equal width."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ["  ".join(f"{cell:{width}}" for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def knobs_figure(study: KnobStudy) -> "Figure":
    """Draws what the whole range of each knob does to the first two tracked coordinates, a dot for each gait."""
    tracked = np.flatnonzero(study.space.tracked)[:2]
    figure = new_figure(3.6)
    panel = figure.subplots()
    for number, knob in enumerate(study.knobs):
        effect = study.effects[:, tracked, number]
        x, y = (effect[:, 0], effect[:, 1]) if len(tracked) > 1 else (effect[:, 0], np.full(len(effect), -number))
        (dots,) = panel.plot(x, y, ".", ms=3)
        panel.plot(
            [0, x.mean()], [0 if len(tracked) > 1 else -number, y.mean()], color=dots.get_color(), label=knob.key
        )
    panel.axhline(0, color="0.85", lw=0.6, zorder=0)
    panel.axvline(0, color="0.85", lw=0.6, zorder=0)
    labels = [f"change of the next {axis_label(study.space.state[row], capital=False)}" for row in tracked]
    panel.set(xlabel=labels[0], ylabel=labels[1] if len(labels) > 1 else "", title="Effect of the whole range")
    panel.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), frameon=False)
    return figure
