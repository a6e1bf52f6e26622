"""The figures in the report of a run: each is one `RunFigure` in a module of this folder, and needs no other place."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib import import_module
from operator import attrgetter
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, NamedTuple

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError
from stepgap.base.plugins import one_of
from stepgap.experiment.run import Run
from stepgap.records.missing import Missing
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import Drawing, draw_figure, shown_in_notebooks

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure


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
    figures = {part.name: part for module in modules for part in vars(module).values() if isinstance(part, RunFigure)}
    return sorted(figures.values(), key=attrgetter("place"))


def drawn_figures(analysis: Analysis) -> list[DrawnFigure]:
    """Draws the figures of a run."""
    return [part.drawn() for part in _parts(analysis) if part.is_known]


def run_figure(run: Run, name: str) -> "Figure":
    """Draws one figure of the report of a run.

    Args:
        name: Name of the figure's file, such as `tracking`.

    Raises:
        InputError: There is no such figure of this run, or a file of the run is not valid; the message has the names.
    """
    parts = {part.file: part for part in _parts(Analysis(run.checked()))}
    with one_blas_thread():
        if name not in parts or not parts[name].is_known:
            names = [file for file, part in parts.items() if part.is_known]
            raise InputError(f"figure {name!r:.80}: this run has {one_of(name, names)}")
        return shown_in_notebooks(parts[name].draw)


class _Part(NamedTuple):
    """A figure that is not drawn yet: of the whole run, or of the state coordinate with index `row`."""

    figure: RunFigure
    analysis: Analysis
    row: int | None

    @property
    def is_known(self) -> bool:
        """Whether all that is drawn is known; to find that out may take seconds."""
        return self.figure.is_known(self.analysis)

    @property
    def file(self) -> str:
        return self.figure.name if self.row is None else f"{self.figure.name}_{self._coordinate}"

    @property
    def _coordinate(self) -> str:
        return "" if self.row is None else self.analysis.run.space.state_names[self.row]

    @property
    def _arguments(self) -> tuple[Any, ...]:
        return (self.analysis,) if self.row is None else (self.analysis, self.row)

    def draw(self) -> "Figure":
        return self.figure.draw(*self._arguments)

    def drawn(self) -> DrawnFigure:
        of_what = "" if self.row is None else f" of {self._coordinate}"
        return DrawnFigure(
            section=self.figure.section,
            file=self.file,
            prefix=f"{self.figure.name}-" if self.row is None else f"{self.figure.name}_{self.row}-",
            caption=self.figure.caption(*self._arguments),
            drawing=draw_figure(self.draw, f"{self.figure.subject}{of_what}"),
        )


def _parts(analysis: Analysis) -> Iterator[_Part]:
    for figure in run_figures():
        rows = range(len(analysis.run.space.state)) if figure.of_each_state else [None]
        yield from (_Part(figure, analysis, row) for row in rows)
