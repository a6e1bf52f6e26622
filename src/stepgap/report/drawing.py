"""Drawing of figures for files and for the page, with the values of their curves, which the page shows at the pointer.

matplotlib is imported when a figure is drawn, so that a report without it lacks only its figures. Figures are made
without `pyplot`, so that none stays open.
"""

import json
import re
from collections.abc import Callable, Container, Mapping
from functools import partial
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from stepgap.base.files import write_whole
from stepgap.base.output_files import format_by_name, write_new
from stepgap.records.missing import Missing
from stepgap.report.own_style import own_style
from stepgap.step import ContextQuantity, Quantity

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

BLACK: Final = "#000000"
BLUE: Final = "#0072b2"
VERMILLION: Final = "#d55e00"
SKY: Final = "#56b4e9"
GREY: Final = "#767676"
LIGHT: Final = "#b8b8b8"
"""Colours of figures and charts, after Okabe and Ito; colour-blind readers can distinguish them."""

WIDTH: Final = 7.16
"""Width of every figure [inches]: both columns of a journal's page, so that fonts are printed in their size."""

MOST_VECTORS: Final = 2000
"""Number of steps above which curves are drawn as pixels inside the vector graphic, so that its file stays small."""

LONGEST_LABEL: Final = 26  # Largest number of drawn characters of a name
DOTS_PER_INCH: Final = 200  # Resolution of the PNG files
NOTEBOOK_DOTS: Final = 60  # Resolution in the cells of notebooks, whose files stay small

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

_REMEDY: Final = "figures need a working matplotlib (pip install --force-reinstall matplotlib)"

LONGEST_ERROR: Final = 120  # Largest number of quoted characters of an error

HOVER_SCRIPT: Final = files("stepgap.report").joinpath("hover.js").read_text(encoding="utf-8")
"""Script that shows the values; it does nothing on a page without figures."""

MOST_VALUES: Final = 2000
"""Number of points above which the values of a curve are not on the page, so that it stays small."""


class Drawing(NamedTuple):
    """A figure that was drawn for a page.

    Attributes:
        svg: Vector graphic for a page.
        hover: Values of its curves, as `hover_values` gives them.
        saved: Function that draws it in another format, `png` or `pdf`; it takes as long as for the page.
    """

    svg: str
    hover: str
    saved: Callable[[str], bytes]


def draw_figure(make: Callable[[], Any], subject: str) -> Drawing | Missing:
    """Draws the figure made by `make`, or returns the reason why it cannot be drawn.

    Args:
        make: Returns a `matplotlib.figure.Figure`; it may import other modules.
        subject: Subject of the figure, for the message.
    """
    try:
        return _drawn(make)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        short = " ".join(str(error).split())[:LONGEST_ERROR]
        return Missing(f"no figure of {subject} could be drawn ({type(error).__name__}: {short}); {_REMEDY}")


def new_figure(height: float) -> "Figure":
    """An empty figure of the usual width.

    Args:
        height: Its height [inches].
    """
    from matplotlib.figure import Figure

    return Figure(figsize=(WIDTH, height), layout="constrained")


def shown_in_notebooks(make: Callable[[], "Figure"]) -> "Figure":
    """Draws a figure that notebooks show as a picture; without `pyplot`, they would show its name alone.

    Args:
        make: Returns the figure; it may import other modules.
    """
    with own_style(LOOK):
        figure = make()
    vars(figure)["_repr_png_"] = partial(_saved, figure, "png", NOTEBOOK_DOTS)
    return figure


def _drawn(make: Callable[[], Any]) -> Drawing:
    with own_style(LOOK):
        figure = make()
        _lay_out(figure)
        return Drawing(_saved(figure, "svg").decode(), hover_values(figure), partial(_saved_later, figure))


def _saved_later(figure: Any, file_format: str) -> bytes:
    with own_style(LOOK):
        return _saved(figure, file_format)


def write_picture(path: Path, make: Callable[[], "Figure"]) -> None:
    """Writes a figure into a new file for `--out` in the format of its name, and prints its path.

    Args:
        make: Returns the figure; it may import other modules.

    Raises:
        InputError: The name has no known ending, or the file cannot be written.
    """
    with own_style():
        from matplotlib.backend_bases import FigureCanvasBase

        form = format_by_name(path, FigureCanvasBase.filetypes)
        content = BytesIO()
        make().savefig(content, dpi=150, format=form)
    write_new(path, "--out", content.getvalue())


def has_figures(folder: Path) -> bool:
    """Whether a folder has files of figures."""
    return (folder / "figures").is_dir()


def write_figures(folder: Path, drawings: Mapping[str, Drawing | Missing]) -> None:
    """Writes `figures/NAME.png` and `figures/NAME.pdf` of the figures that could be drawn, by their names.

    Raises:
        OSError: A file cannot be written.
    """
    names: list[str] = []
    for wanted, drawing in drawings.items():
        names.append(_file_name(wanted, names))
        if isinstance(drawing, Drawing):
            for form in ("png", "pdf"):
                write_whole(folder / "figures" / f"{names[-1]}.{form}", drawing.saved(form))


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


def _saved(figure: Any, file_format: str, dots: int = DOTS_PER_INCH) -> bytes:
    stream = BytesIO()
    figure.savefig(stream, format=file_format, dpi=dots, metadata=dict(UNDATED.get(file_format, {})))
    return stream.getvalue()


def axis_label(quantity: Quantity | ContextQuantity, capital: bool = True) -> str:
    """Name of a coordinate with its unit, if the unit is known."""
    name = plain(quantity.name.replace("_", " "))
    return f"{name[:1].upper() + name[1:] if capital else name}{unit_label(quantity)}"


def plain(text: str) -> str:
    """Text that the figures' font contains: one short line of Latin, Greek or Cyrillic letters, without formulae."""
    drawn = "".join(letter if letter.isprintable() and ord(letter) < 0x500 else "?" for letter in text)
    return (drawn if len(drawn) <= LONGEST_LABEL else f"{drawn[: LONGEST_LABEL - 1]}…").replace("$", r"\$")


def unit_label(quantity: Quantity | ContextQuantity) -> str:
    """The unit in brackets after a space; empty where it is not known."""
    return f" [{plain(quantity.unit)}]" if quantity.unit else ""


def hover_values(figure: Any) -> str:
    """The curves of a figure that is laid out, as JSON for `hover.js`.

    It is a list of panels. A panel has its `box` (left, top, right, bottom, as fractions of the figure), its axes `x`
    and `y` (lower end, upper end, whether it is logarithmic, label) and its `curves` (label, x and y of the points).
    All x and all y are one text, with four digits a number, because a quotation mark takes six bytes in the page.

    Args:
        figure: A `matplotlib.figure.Figure`.
    """
    panels = [_panel(axes) for axes in figure.axes]
    return json.dumps([panel for panel in panels if panel["curves"]], separators=(",", ":"), ensure_ascii=False)


def _panel(axes: Any) -> dict[str, Any]:
    box = axes.get_position()
    return {
        "box": [round(float(edge), 4) for edge in (box.x0, 1 - box.y1, box.x1, 1 - box.y0)],
        "x": [*map(float, axes.get_xlim()), axes.get_xscale() == "log", _shared_label(axes)],
        "y": [*map(float, axes.get_ylim()), axes.get_yscale() == "log", _in_one_line(axes.get_ylabel())],
        "curves": [curve for line in axes.lines if line.get_transform() == axes.transData for curve in _curve(line)],
    }


def _curve(line: Any) -> list[list[str]]:
    """Label and points of a line; nothing if there are none or too many."""
    points = np.column_stack([np.asarray(values, float) for values in (line.get_xdata(), line.get_ydata())])
    points = points[np.isfinite(points).all(axis=1)]
    label = str(line.get_label())
    if not 0 < len(points) <= MOST_VALUES:
        return []
    values = [" ".join(f"{value:.4g}" for value in column) for column in points.T]
    return [["" if label.startswith("_") else _in_one_line(label), *values]]


def _shared_label(axes: Any) -> str:
    """Label of the horizontal axis, which only the lowest of several panels shows."""
    labels = [axes.get_xlabel(), *(sibling.get_xlabel() for sibling in axes.get_shared_x_axes().get_siblings(axes))]
    return _in_one_line(next(filter(None, labels), ""))


def _in_one_line(text: str) -> str:
    """Text of a label in one line."""
    return " ".join(text.replace("\\$", "$").split())
