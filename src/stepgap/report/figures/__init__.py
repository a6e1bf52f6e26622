"""The figures in the report of a run: each is one `RunFigure` in a module of this folder, and needs no other place."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from pkgutil import iter_modules
from typing import Any, NamedTuple

from stepgap.records.missing import Missing
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import Drawing, draw_figure


@dataclass(frozen=True)
class RunFigure:
    """A figure in the report of a run.

    Its module must not import matplotlib where it begins, so that a report without it lacks only its figures.

    Attributes:
        name: Name of its files.
        section: Section of the page in which it stands, a key of `page.CONTENTS`.
        place: Its place in the section: figures are in the ascending order of this number.
        subject: What it shows, for the message that it cannot be drawn.
        caption: Function `Analysis` → text below the figure.
        draw: Function `Analysis` → `matplotlib.figure.Figure`.
        is_known: Function `Analysis` → whether all that is drawn is known; otherwise the figure is left out.
        of_each_state: Whether there is one for each state coordinate, whose index `caption` and `draw` then also get.
    """

    name: str
    section: str
    place: float
    subject: str
    caption: Callable[..., str]
    draw: Callable[..., Any]
    is_known: Callable[[Analysis], bool] = lambda analysis: True
    of_each_state: bool = False


class DrawnFigure(NamedTuple):
    """A drawn figure of a run.

    Attributes:
        section: Section of the page in which it stands.
        file: Name of its files, without their formats.
        prefix: Prefix of its identifiers on the page.
        caption: Text below it.
        drawing: The figure, or the reason why there is none.
    """

    section: str
    file: str
    prefix: str
    caption: str
    drawing: Drawing | Missing


def run_figures() -> list[RunFigure]:
    """The figures that the modules of this folder define, in their order."""
    modules = [import_module(f"{__name__}.{module.name}") for module in iter_modules(__path__)]
    found = {each.name: each for module in modules for each in vars(module).values() if isinstance(each, RunFigure)}
    return sorted(found.values(), key=attrgetter("place"))


def drawn_figures(analysis: Analysis) -> list[DrawnFigure]:
    """Draws the figures of a run."""
    return [drawn for figure in run_figures() if figure.is_known(analysis) for drawn in _drawn(figure, analysis)]


def _drawn(figure: RunFigure, analysis: Analysis) -> Iterator[DrawnFigure]:
    """The figure, or that of each state coordinate."""
    if not figure.of_each_state:
        drawing = draw_figure(lambda: figure.draw(analysis), figure.subject)
        yield DrawnFigure(figure.section, figure.name, f"{figure.name}-", figure.caption(analysis), drawing=drawing)
        return
    for row, name in enumerate(analysis.run.space.state_names):
        drawing = draw_figure(lambda row=row: figure.draw(analysis, row), f"{figure.subject} of {name}")
        caption = figure.caption(analysis, row)
        prefix = f"{figure.name}_{row}-"
        yield DrawnFigure(figure.section, f"{figure.name}_{name}", prefix, caption, drawing=drawing)
