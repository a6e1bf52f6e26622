"""What explains the error of a run: sentences, a table and a figure."""

from collections.abc import Mapping
from math import isinf
from typing import TYPE_CHECKING, Final

import numpy as np

from stepgap.base.normal import INTERVAL_95
from stepgap.base.ranges import format_value
from stepgap.records.text import in_words, listed
from stepgap.report.drawing import BLUE, GREY, draw_figure, new_figure, plain
from stepgap.report.html import bullets, page, paragraph, picture, section, table
from stepgap.step import StepSpace
from stepgap.study.explanation import REST_LOG_ODDS, CauseSize, Explanation

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

LEAST_EXPLAINED: Final = 0.1  # Share of the squared difference from which on a cause is worth a sentence

_CAPTION: Final = (
    "Left: share of the squared difference between the errors of the run and of the simulated robot without gap, less "
    "noise, that each cause explains alone. Right: sizes where all causes may act, with 95 % intervals."
)

METHOD: Final = (
    "Each cause was set alone in the simulated robot, which then tracked states of the run; the change of the error "
    "per size is its signature. The sizes follow from the error of the run by one regression on all signatures, and, "
    "alone, by one on each. Where signatures are alike, the intervals of the sizes together are wide."
)


def explanation_sentences(explanation: Explanation, space: StepSpace) -> list[str]:
    """What explains the error, with sizes, what does not, and what to do."""
    rms = in_words(space.state, explanation.difference * space.state_scale)
    silent = {
        "whose effect it could not see": explanation.unseen,
        "with which the simulated robot falls": explanation.failed,
    }
    return [
        f"the errors of this run differ from those of the simulated robot without gap by {rms} (rms, less noise)",
        *_size_sentences(explanation),
        *_alike_sentences(explanation),
        _rest_sentence(explanation),
        *(
            f"this run says nothing of {listed([cause.name for cause in causes])}, {reason}"
            for reason, causes in silent.items()
            if causes
        ),
    ]


def _size_sentences(explanation: Explanation) -> list[str]:
    """The cause that explains most alone, and those that act whatever the others do."""
    best = next(iter(explanation.causes), None)
    if best is None or best.explained < LEAST_EXPLAINED:
        return ["none of the causes alone explains a tenth of the squared difference"]
    alone = _shown(best, best.cause.value(best.alone))
    share = _percent(best.explained)
    alike = {cause for group in explanation.alike for cause in group}
    acting = [
        f"{size.cause.name} {_shown(size, size.value)} ({_interval(size)})"
        for size in explanation.causes
        if size.acts and size.cause not in alike
    ]
    return [
        f"of single causes, {best.cause.name} {alone} explains most: {share} of the squared difference",
        f"whatever the other causes do, these act: {listed(acting)} (95 % intervals)"
        if acting
        else "where all causes may act, no single one is certain to act",
    ]


def _alike_sentences(explanation: Explanation) -> list[str]:
    """Which causes cannot be told apart, of the groups that explain something."""
    explained = {size.cause: size.explained for size in explanation.causes}
    groups = [group for group in explanation.alike if max(explained[cause] for cause in group) >= LEAST_EXPLAINED]
    return [
        f"this run cannot tell {listed([cause.name for cause in group])} apart: measure one, and give it as --known"
        for group in groups
    ]


def explanation_table(explanation: Explanation, meanings: Mapping[str, str]) -> tuple[list[str], list[list[str]]]:
    """Heads and rows of the table of causes that the run sees.

    Args:
        meanings: Text on each cause.
    """
    heads = ["cause", "size", "95 % interval", "size alone", "explains alone", "without gap", "meaning"]
    rows = [
        [
            size.cause.name,
            _shown(size, size.value),
            _interval(size),
            _shown(size, size.cause.value(size.alone)),
            _percent(size.explained),
            format_value(size.cause.exact),
            meanings.get(size.cause.name, "").split(". ")[0].rstrip("."),
        ]
        for size in explanation.causes
    ]
    return heads, rows


def explanation_figure(explanation: Explanation) -> "Figure":
    """Bars of what each cause explains alone, and intervals of the sizes where all may act."""
    sizes = explanation.causes
    figure = new_figure(0.9 + 0.22 * len(sizes))
    shares, intervals = figure.subplots(1, 2, sharey=True)
    for row, size in enumerate(sizes):
        shares.barh(-row, 100 * size.explained, color=BLUE, height=0.7)
        colour = BLUE if size.acts else GREY
        half = INTERVAL_95 * size.std
        intervals.errorbar(size.share, -row, xerr=half, fmt="o", color=colour, capsize=2)
    shares.set_yticks([-row for row in range(len(sizes))], [plain(size.cause.name) for size in sizes])
    shares.set_xlim(0, 100)
    shares.set_xlabel("Explained alone [%]")
    intervals.axvline(0, color=GREY, linewidth=0.7)
    intervals.set_xlabel("Size [usual sizes]")
    for panel in (shares, intervals):
        panel.spines[["top", "right"]].set_visible(False)
    return figure


def explanation_page(name: str, explanation: Explanation, space: StepSpace, meanings: Mapping[str, str]) -> str:
    """HTML page on what explains the error of a run.

    Args:
        space: State and command of the run.
        meanings: Text on each cause.
    """
    drawing = draw_figure(lambda: explanation_figure(explanation), "the sizes")
    title = f"What explains the error of {name}"
    sentences = bullets(explanation_sentences(explanation, space))
    rows = table("", *explanation_table(explanation, meanings))
    figure = picture(drawing, "causes-", _CAPTION)
    return page("StepGap explanation", [section("causes", title, sentences, figure, rows, paragraph(METHOD))])


def _interval(size: CauseSize) -> str:
    return " to ".join(_shown(size, end) for end in size.interval)


def _shown(size: CauseSize, value: float) -> str:
    """A value of a cause with decimals by its usual one."""
    if isinf(value):
        return "∞"
    usual = size.cause.usual if isinf(size.cause.exact) else size.cause.usual - size.cause.exact
    places = max(0, 2 - int(np.floor(np.log10(abs(usual)))))
    return f"{value:.{places}f}".replace("-", "−")


def _rest_sentence(explanation: Explanation) -> str:
    share = _percent(explanation.rest)
    if explanation.has_rest:
        return (
            f"{share} of the squared difference is none of these causes; that is more than noise and inaccurate "
            "simulation explain: something is not in the list, or acts only together with others"
        )
    if explanation.rest_log_odds > REST_LOG_ODDS:
        return (
            f"the rest, {share}, is small, but more than noise: signatures are inaccurate, or one that is not in the "
            "list acts nearly as those named here"
        )
    return f"the rest, {share}, is no larger than noise and inaccurate simulation explain"


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
