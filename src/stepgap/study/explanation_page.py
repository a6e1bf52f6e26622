"""What explains the error of a run: sentences, a table and a figure."""

from collections.abc import Mapping
from math import exp, isinf
from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.base.ranges import format_value
from stepgap.records.text import decimal, in_words, listed
from stepgap.report.drawing import BLUE, LIGHT, draw_figure, new_figure, plain
from stepgap.report.html import bullets, page, paragraph, picture, safe, section, table
from stepgap.step import StepSpace
from stepgap.study.cause_sizes import Cause
from stepgap.study.explanation import CAUSE_LOG_ODDS, TOLD_APART, CauseGroup, Explanation, Member

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

EXPERIMENTS: Final[Mapping[str, str]] = {
    "body_com_offset": "hang the body up at two points: its centre of mass is below both",
    "ground_friction": "pull the foot over the ground under a known load, and measure the force",
    "mass": "weigh the part, or add a known mass and run again",
    "payload": "weigh the part, or add a known mass and run again",
    "inertia": "let the part swing as a pendulum",
    "torque_scale": "torque steps against a scale",
    "torque_imbalance": "torque steps of each motor against a scale",
    "gear": "force steps against a scale",
    "lag": "torque steps, with a log of when the torque rises",
    "delay": "torque steps, with a log of when the torque begins to rise",
    "saturation": "torque steps up to the largest torque",
    "friction": "move the part slowly by hand, and measure the force at which it moves",
    "damping": "move the part at several constant speeds, and measure the force",
    "drag": "move the part at several constant speeds, and measure the force",
    "stiffness": "press with a known force, and measure how far it yields",
    "softness": "press with a known force, and measure how far it yields",
    "offset": "put the part into a known position, and read the sensor",
    "slope": "a spirit level",
    "tilt": "a spirit level",
}
"""Experiments without a step that measure a difference, by a word in its name."""

SHARES_CAPTION: Final = (
    "Share of the squared difference between the errors of the run and of the simulated robot without gap, less noise, "
    "that each group of causes explains, and what none explains."
)

METHOD: Final = (
    "Each cause was set alone in the simulated robot, which then tracked states of the run; the change of the error is "
    "its signature. Causes are found one after the other by evidence, simulated again at the sizes found. Causes whose "
    "signatures are alike form a group. ± is half of a 95 % interval, which includes the inaccuracy of the signatures."
)


def explanation_sentences(explanation: Explanation, space: StepSpace) -> list[str]:
    """What explains the error, with sizes, what does not, and what to do."""
    rms = in_words(space.state, explanation.difference * space.state_scale)
    difference = (
        f"the errors of this run differ from those of the simulated robot without gap by {rms} (rms, less noise)"
    )
    groups = [_group_sentence(each) for each in explanation.groups]
    if not groups:
        groups = ["none of the causes makes these errors 20 times more probable than an error of unknown form does"]
    return [difference, *groups, _rest_sentence(explanation), *_advice(explanation)]


def explanation_table(explanation: Explanation, meanings: Mapping[str, str]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table of causes: those of the groups that are in question.

    Args:
        explanation: What was found.
        meanings: Text on each cause.
    """
    heads = ["cause", "size", "95 % interval", "without gap", "group", "odds in the group", "meaning"]
    rows = [
        [
            each.cause.name,
            _in_interval(each, each.value),
            " to ".join(_in_interval(each, end) for end in each.interval),
            format_value(each.cause.exact),
            str(number),
            f"1 : {_odds(-each.log_odds)}",
            _first_sentence(meanings.get(each.cause.name, "")),
        ]
        for number, group in enumerate(explanation.groups, 1)
        for each in members_in_question(group)
    ]
    return heads, rows


def explanation_figure(explanation: Explanation) -> "Figure":
    """Bars of the shares of the squared difference."""
    bars = [(_named(group), group.explained, BLUE) for group in explanation.groups]
    bars.append(("none of the causes", explanation.rest, LIGHT))
    figure = new_figure(0.7 + 0.3 * len(bars))
    panel = figure.subplots()
    for row, (_, share, colour) in enumerate(bars):
        panel.barh(-row, 100 * share, color=colour, height=0.7)
        panel.annotate(f" {share:.0%}", (100 * share, -row), va="center")
    panel.set_yticks([-row for row in range(len(bars))], [plain(name) for name, _, _ in bars])
    panel.spines[["top", "right"]].set_visible(False)
    panel.set_xlim(0, 110)
    panel.set_xlabel("Share of the squared difference [%]")
    return figure


def explanation_page(name: str, explanation: Explanation, space: StepSpace, meanings: Mapping[str, str]) -> str:
    """HTML page on what explains the error of a run.

    Args:
        name: Name of the run.
        explanation: What was found.
        space: State and command of the run.
        meanings: Text on each cause.
    """
    drawing = draw_figure(lambda: explanation_figure(explanation), "the shares")
    alike = [listed([each.name for each in group]) for group in explanation.alike if len(group) > 1]
    parts = [
        section(
            "causes",
            "Causes",
            bullets(explanation_sentences(explanation, space)),
            picture(drawing, "causes-", SHARES_CAPTION),
        ),
        section("sizes", "Sizes", table("", *explanation_table(explanation, meanings)), paragraph(METHOD)),
    ]
    if alike:
        parts.append(section("alike", "Causes whose signatures are alike in this run", bullets(alike)))
    if silent := _silent(explanation):
        parts.append(section("left-out", "Causes of which this run says nothing", bullets(silent)))
    return page("StepGap explanation", [f"<h1>What explains the error of {safe(name)}</h1>", *parts])


def members_in_question(group: CauseGroup) -> list[Member]:
    """Causes of a group that explain the errors about as well as its first."""
    return [each for each in group.members if each.log_odds > -TOLD_APART]


def _group_sentence(group: CauseGroup) -> str:
    possible = members_in_question(group)
    sizes = listed([f"{each.cause.name} {_size(each)}" for each in possible], "or")
    alike = ", which this run cannot tell apart," if len(possible) > 1 else ""
    return f"{sizes}{alike} explains {group.explained:.0%} of the squared difference".replace("%", " %")


def _size(member: Member) -> str:
    low, high = member.interval
    if isinf(high):
        return f"{_in_interval(member, member.value)} (at least {_in_interval(member, low)})"
    half = (high - low) / 2
    lopsided = max(high - member.value, member.value - low) > 1.2 * half
    ends = f"({_in_interval(member, low)} to {_in_interval(member, high)})" if lopsided else f"± {decimal(half, 1)}"
    return f"{_in_interval(member, member.value)} {ends}"


def _in_interval(member: Member, value: float) -> str:
    """A value with two digits of the half width of the interval of a cause, at least three of its own."""
    low, high = member.interval
    if isinf(value):
        return "∞"
    half = high - member.value if not isinf(high) else member.value - low
    ratio = abs(value) / half if half > 0 else 1.0
    return decimal(value, min(max(3, 2 + int(np.floor(np.log10(max(ratio, 1.0))))), 8))


def _rest_sentence(explanation: Explanation) -> str:
    share = f"{explanation.rest:.0%}".replace("%", " %")
    if explanation.has_rest:
        return (
            f"{share} of the squared difference is none of these causes; that is more than noise and inaccurate "
            "simulation explain: something is not in the list, or acts only together with others"
        )
    if explanation.rest_log_odds > CAUSE_LOG_ODDS:
        return (
            f"the rest, {share}, is small, but more than noise: a small cause may act that was not found, or one that "
            "is not in the list acts nearly as those named here"
        )
    return f"the rest, {share}, is no larger than noise and inaccurate simulation explain"


def _advice(explanation: Explanation) -> list[str]:
    lines = []
    for group in explanation.groups:
        possible = members_in_question(group)
        known = {each.cause.name: how for each in possible if (how := _experiment(each.cause))}
        if len(possible) > 1 and known:
            told = "; ".join(f"for {name}, {how}" for name, how in known.items())
            lines.append(f"to tell them apart: {told}")
    large = [_named(group) for group in explanation.groups if group.explained > 0.1]
    if large:
        lines.append(f"to mend in the model, after it was measured: {listed(large)}; the residual learns what is left")
    elif explanation.groups and not explanation.has_rest:
        lines.append("nothing of this is worth a change of the model: the residual learns it")
    return lines


def _experiment(cause: Cause) -> str:
    return next((how for word, how in EXPERIMENTS.items() if word in cause.name), "")


def _silent(explanation: Explanation) -> list[str]:
    pairs = (
        ("has no effect here that this run could see", explanation.unseen),
        ("the simulated robot falls with a usual size of it", explanation.failed),
    )
    return [f"{text}: {listed([each.name for each in causes])}" for text, causes in pairs if causes]


def _named(group: CauseGroup) -> str:
    return listed([each.cause.name for each in members_in_question(group)], "or")


def _odds(log: float) -> str:
    return decimal(exp(log), 2)


def _first_sentence(text: str) -> str:
    return text.split(". ")[0].rstrip(".")
