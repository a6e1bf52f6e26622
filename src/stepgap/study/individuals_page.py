"""What distinguishes robots of one type in what was learned of them: sentences, a figure and a table."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.records.text import decimal, in_scale, trimmed, unit_suffix, with_unit
from stepgap.report.drawing import GREY, LIGHT, VERMILLION, draw_figure, new_figure, plain
from stepgap.report.html import bullets, paragraph, picture, section, table
from stepgap.study.individuals import LEAST_ROBOTS, ComparedRobots, Trait

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

DIFFERENCES_CAPTION: Final = (
    "Each dot is a robot: its difference from the others, in standard deviations of those that are alike. Robots that "
    "are unlike the others are named."
)

EXPLANATION: Final = (
    "The steps of each robot are compared with the median of what was learned of all, at the same state and command. "
    "The table has the differences from the mean of the others, with 95 % intervals; * marks a robot that is unlike "
    "the others. Of twenty sets of robots that are alike, one or two have such a mark by chance."
)


def difference_sentences(comparison: ComparedRobots) -> list[str]:
    """Which robots are unlike the others, and in what; one sentence that none is, or can be named."""
    count = len(comparison.names)
    if count < LEAST_ROBOTS:
        return [f"{count} robots are too few to say which one is unlike the others; {LEAST_ROBOTS} are needed"]
    found = [
        _sentence(comparison, int(row), int(column)) for row, column in zip(*np.nonzero(comparison.unlike), strict=True)
    ]
    return found or [
        f"no robot is unlike the others: no difference is larger than the spread of {count} robots explains"
    ]


def differences_table(comparison: ComparedRobots) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table of differences: a row for each trait, a column for each robot."""
    heads = ["", *comparison.names, "spread of those that are alike"]
    rows = [
        [
            trait_name(comparison, trait),
            *(_cell(comparison, row, column) for row in range(len(comparison.names))),
            _shown(comparison, column, float(comparison.spread[column])),
        ]
        for column, trait in enumerate(comparison.traits)
    ]
    return heads, rows


def differences_section(comparison: ComparedRobots) -> str:
    """HTML section of a page on these robots."""
    drawing = draw_figure(lambda: differences_figure(comparison), "the differences")
    return section(
        "individuals",
        "What was learned of the robots",
        bullets(difference_sentences(comparison)),
        picture(drawing, "individuals-", DIFFERENCES_CAPTION),
        paragraph(f"{EXPLANATION} Offsets are those at {_middle(comparison)}."),
        table("", *differences_table(comparison)),
    )


def differences_figure(comparison: ComparedRobots) -> "Figure":
    """Every trait of every robot, by its distance from the others."""
    figure = new_figure(0.8 + 0.24 * len(comparison.traits))
    panel = figure.subplots()
    distance = comparison.difference / np.maximum(comparison.spread, np.finfo(float).tiny)
    for column in range(len(comparison.traits)):
        for row, name in enumerate(comparison.names):
            odd = bool(comparison.unlike[row, column])
            at = float(distance[row, column]), -column
            panel.plot(*at, "o", color=VERMILLION if odd else GREY, markersize=5 if odd else 3)
            if odd:
                side = "left" if at[0] < 0 else "right"
                beside = {"xytext": (6 if side == "left" else -6, 0), "textcoords": "offset points", "va": "center"}
                panel.annotate(plain(name), at, ha=side, color=VERMILLION, **beside)
    panel.axvline(0, color=LIGHT, linewidth=0.8, zorder=0)
    names = [plain(trait_name(comparison, trait)) for trait in comparison.traits]
    panel.set_yticks([-column for column in range(len(names))], names)
    panel.spines[["top", "right"]].set_visible(False)
    panel.set_xlabel("Difference from the others [standard deviations of those that are alike]")
    return figure


def trait_name(comparison: ComparedRobots, trait: Trait) -> str:
    """What a trait is, with its unit."""
    state = comparison.space.state[trait.state]
    if trait.kind == "offset":
        return with_unit(state)
    if trait.kind == "noise":
        return f"logarithm of the noise of {state.name}"
    command = comparison.space.command[trait.command]
    unit = _per(state.unit, command.unit)
    return f"{state.name} by {command.name}{f' [{unit}]' if unit else ''}"


def _sentence(comparison: ComparedRobots, row: int, column: int) -> str:
    trait, name = comparison.traits[column], comparison.names[row]
    state, command = comparison.space.state[trait.state], comparison.space.command[trait.command]
    difference, half = float(comparison.difference[row, column]), float(comparison.interval[row, column])
    if trait.kind == "noise":
        ends = (decimal(float(np.exp(difference + sign * half)), 2) for sign in (-1, 1))
        ratio = decimal(float(np.exp(difference)), 2)
        return (
            f"{name}: its {state.name} scatters {ratio} times as much as that of the others (95 %: {' to '.join(ends)})"
        )
    size, margin = decimal(abs(difference), 2), decimal(half, 1)
    if trait.kind == "offset":
        amount = f"{size}{unit_suffix(state)} {'lower' if difference < 0 else 'higher'}"
        return f"{name}: its {state.name} is {amount} than that of the others (± {margin}) at {_middle(comparison)}"
    unit = _per(state.unit, command.unit)
    amount = f"{size}{f' {unit}' if unit else ''} {'less' if difference < 0 else 'more'}"
    return f"{name}: its {state.name} grows by {amount} with {command.name} than that of the others (± {margin})"


def _middle(comparison: ComparedRobots) -> str:
    pairs = zip(comparison.space.command, comparison.middle.tolist(), strict=True)
    return ", ".join(f"{each.name} {trimmed(in_scale(value, each, 2))}{unit_suffix(each)}" for each, value in pairs)


def _per(unit: str, command_unit: str) -> str:
    """Unit of a gain; none where both are the same, or one is unknown."""
    return "" if unit == command_unit or not (unit and command_unit) else f"{unit} per {command_unit}"


def _cell(comparison: ComparedRobots, row: int, column: int) -> str:
    value = _shown(comparison, column, float(comparison.difference[row, column]), signed=True)
    half = _shown(comparison, column, float(comparison.interval[row, column]))
    return f"{value} ± {half}{' *' if comparison.unlike[row, column] else ''}"


def _shown(comparison: ComparedRobots, column: int, value: float, *, signed: bool = False) -> str:
    """A difference or spread of a trait, with decimals by the spread of all."""
    whole = float(np.max(np.abs(comparison.difference[:, column]), initial=0.0))
    places = max(0, 1 - int(np.floor(np.log10(whole)))) if whole > 0 else 3
    text = f"{value:{'+' if signed else ''}.{min(places, 6)}f}" if np.isfinite(value) else "–"
    return text.replace("-", "−")


def passports_table(passports: Sequence[tuple[str, dict[str, str]]]) -> str:
    """HTML table of what is known of robots, by name."""
    keys = list(dict.fromkeys(key for _, each in passports for key in each))
    return table("", ["", *keys], [[name, *(each.get(key, "–") for key in keys)] for name, each in passports])
