"""Figures as files and as parts of a page."""

from collections.abc import Callable, Mapping
from io import BytesIO
from typing import Any, Final, NamedTuple

from stepgap.records.missing import Missing

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
"""Settings of matplotlib while drawing: letters of 8 points; TrueType in PDF files, since journals refuse Type 3."""

UNDATED: Final[Mapping[str, Mapping[str, None]]] = {
    "svg": dict.fromkeys(("Creator", "Date", "Format", "Type")),
    "pdf": dict.fromkeys(("Creator", "Producer", "CreationDate")),
}
"""Metadata that files do not get, so that the same run gives the same bytes."""

HOW_TO_MEND: Final = (
    "figures need a sound matplotlib, pip install --force-reinstall matplotlib, and no unknown backend in the "
    "environment variable MPLBACKEND"
)
"""What to do where drawing fails."""


LONGEST_ERROR: Final = 120
"""Characters of an error that are quoted at most."""


class Drawing(NamedTuple):
    """A figure in the formats in which it is kept."""

    svg: str
    png: bytes
    pdf: bytes


def draw_figure(make: Callable[[], Any], what: str) -> Drawing | Missing:
    """The figure that `make` gives, or why it cannot be drawn.

    Args:
        make: Gives a `matplotlib.figure.Figure`; it may import what it needs.
        what: Subject of the figure, for the reason.
    """
    try:
        from matplotlib import rc_context

        with rc_context(LOOK):
            figure = make()
            figure.draw_without_rendering()
            figure.set_layout_engine(None)  # found once and the same in all formats; with one, savefig draws twice
            return Drawing(_saved(figure, "svg").decode(), _saved(figure, "png"), _saved(figure, "pdf"))
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        short = " ".join(str(error).split())[:LONGEST_ERROR]
        return Missing(f"no figure of {what} could be drawn ({type(error).__name__}: {short}); {HOW_TO_MEND}")


def _saved(figure: Any, file_format: str) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format=file_format, dpi=DOTS_PER_INCH, metadata=dict(UNDATED.get(file_format, {})))
    return stream.getvalue()
