"""Drawing of figures for files and for the page."""

import re
from collections.abc import Callable, Container, Mapping
from io import BytesIO
from pathlib import Path
from typing import Any, Final, NamedTuple

from stepgap.base.files import write_whole
from stepgap.base.garbage_collection import paused_collection
from stepgap.records.missing import Missing
from stepgap.report.hover import hover_values

DOTS_PER_INCH: Final = 200
"""Resolution of the PNG files."""

LOOK: Final[dict[Any, Any]] = {
    "font.size": 8,
    "lines.linewidth": 1.2,
    "lines.markersize": 5,
    "lines.markeredgewidth": 0.8,
    "axes.linewidth": 0.7,
    "pdf.fonttype": 42,
}
"""Settings of matplotlib: a font of 8 points; TrueType in PDF files, since journals refuse Type 3 fonts."""

UNDATED: Final[Mapping[str, Mapping[str, None]]] = {
    "svg": dict.fromkeys(("Creator", "Date", "Format", "Type")),
    "pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
}
"""Metadata left out of the files, so that the same run gives the same bytes."""

_REMEDY: Final = (
    "figures need a working matplotlib (pip install --force-reinstall matplotlib) and no unknown backend in the "
    "environment variable MPLBACKEND"
)


LONGEST_ERROR: Final = 120
"""Largest number of quoted characters of an error."""


class Drawing(NamedTuple):
    """A figure in the formats of its files.

    Attributes:
        svg: Vector graphic for a page.
        png: Pixels.
        pdf: Vector graphic for a document.
        hover: Values of its curves, as `hover_values` gives them.
    """

    svg: str
    png: bytes
    pdf: bytes
    hover: str


def draw_figure(make: Callable[[], Any], subject: str) -> Drawing | Missing:
    """Draws the figure made by `make`, or returns the reason why it cannot be drawn.

    Args:
        make: Returns a `matplotlib.figure.Figure`; it may import other modules.
        subject: Subject of the figure, for the message.
    """
    try:
        with paused_collection():  # collections would take an eighth of the time
            return _drawn(make)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        short = " ".join(str(error).split())[:LONGEST_ERROR]
        return Missing(f"no figure of {subject} could be drawn ({type(error).__name__}: {short}); {_REMEDY}")


def _drawn(make: Callable[[], Any]) -> Drawing:
    from matplotlib import rc_context

    with rc_context(LOOK):
        figure = make()
        _lay_out(figure)
        saved = _saved(figure, "svg").decode(), _saved(figure, "png"), _saved(figure, "pdf")
        return Drawing(*saved, hover_values(figure))


def write_figures(folder: Path, drawings: Mapping[str, Drawing | Missing]) -> None:
    """Writes `figures/NAME.png` and `figures/NAME.pdf` of the figures that could be drawn, by their names.

    Raises:
        OSError: A file cannot be written.
    """
    names: list[str] = []
    for wanted, drawing in drawings.items():
        names.append(_file_name(wanted, names))
        if isinstance(drawing, Drawing):
            write_whole(folder / "figures" / f"{names[-1]}.png", drawing.png)
            write_whole(folder / "figures" / f"{names[-1]}.pdf", drawing.pdf)


def _file_name(wanted: str, taken: Container[str]) -> str:
    """A file name that is valid on every file system and not in use yet."""
    name = re.sub(r"[^a-z0-9_-]", "_", wanted.lower())[:60]
    while name in taken:
        name += "_"
    return name


def _lay_out(figure: Any) -> None:
    """Places the axes, once and the same in all formats; with its layout engine, savefig would do it each time."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def _saved(figure: Any, file_format: str) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format=file_format, dpi=DOTS_PER_INCH, metadata=dict(UNDATED.get(file_format, {})))
    return stream.getvalue()
