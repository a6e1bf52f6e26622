"""What people look at: figures and the report of a run.

`run_folder` reads a run, with its `summary`; `figures` draws it; `words` says it; `html` puts both on one page, beside
the numbers of the `paper`.
"""

import re
from collections.abc import Container
from io import BytesIO
from pathlib import Path

from stepgap.files import write_whole
from stepgap.report.figures import error_figure, map_figure, tracking_figure
from stepgap.report.html import report_html
from stepgap.report.run_folder import RunRecord, read_run_folder
from stepgap.step import StepSpace

__all__ = ["RunRecord", "read_run_folder", "write_report"]

DOTS_PER_INCH = 150
"""Resolution of the PNG files."""


def write_report(folder: Path, space: StepSpace | None = None, plant: str = "simulated twin") -> Path:
    """Writes `figures/*.png` and `report.html` of a run, whether or not it is finished.

    A reader of these files sees the old ones or the new ones, never a part.

    Args:
        folder: The run folder.
        space: Names and units of state and command; by default those of the header of `steps.csv`.
        plant: What executed the steps, in words; the report says it.

    Returns:
        Path of the report.

    Raises:
        ValueError: A file of the run is not what it must be; the message names it and says what would be right.
        OSError: A file cannot be read or written.
    """
    record = read_run_folder(folder, space)
    figures = {"tracking": tracking_figure(record), "errors": error_figure(record)}
    for index, name in enumerate(record.space.state_names):
        figures[_file_name(f"map_{name}", figures)] = map_figure(record, index)
    for name, figure in figures.items():
        picture = BytesIO()
        figure.savefig(picture, format="png", dpi=DOTS_PER_INCH)
        write_whole(folder / "figures" / f"{name}.png", picture.getvalue())
    path = folder / "report.html"
    write_whole(path, report_html(record, list(figures.values()), plant))
    return path


def _file_name(wanted: str, taken: Container[str]) -> str:
    """A name that every file system takes and that is not taken yet."""
    name = re.sub(r"[^a-z0-9_-]", "_", wanted.lower())[:60]
    while name in taken:
        name += "_"
    return name
