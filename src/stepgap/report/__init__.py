"""Reports: figures and page of a run, and the comparison of several runs.

A report is made from a `Run` alone. Nothing here builds a plant or a twin, except to simulate a lost replay again.

`analysis` computes what is learned and the limit cycles; the modules in `figures` each draw and describe some figures;
`error_table`, `learned_table`, `gait_table` and `settings_table` make the tables, `sentences`, `diagnosis_sentences`,
`reach_sentences` and `trust_sentences` the text, `replay_view` the replay. `page` puts all on one page, next to
published results, and lists the missing parts. `comparison` makes the page of several runs, `individuals` compares
what was learned of robots. `text`, `html` and `drawing` are for all pages.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError, message_of
from stepgap.base.files import write_whole
from stepgap.experiment.run import Run
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import has_figures, write_figures
from stepgap.report.figures import drawn_figures
from stepgap.report.page import missing_parts, report_html

__all__ = ["FolderReport", "WrittenReport", "write_report"]


class WrittenReport(NamedTuple):
    """A report on disk.

    Attributes:
        path: Path of the page.
        missing: Missing parts, each with the reason in brackets.
    """

    path: Path
    missing: tuple[str, ...]


@dataclass(frozen=True)
class FolderReport:
    """The report of folders of some kind other than runs, such as sweeps, for `stepgap report`.

    Attributes:
        holds: Whether a folder is of this kind.
        write: Writes the report of such a folder into it, and the files of its figures if the second argument is true.
    """

    holds: Callable[[Path], bool]
    write: Callable[[Path, bool], WrittenReport]


def write_report(run: Run, figures: bool = False) -> WrittenReport:
    """Writes `report.html` of a run, whether or not it is finished, and on demand `figures/*.png` and `figures/*.pdf`.

    Each file is replaced atomically: readers see the old or the new content, never a part.

    Args:
        run: The run; the files are written into its folder.
        figures: Whether to write the files of the figures, which takes longer than the page; if the folder has those of
            an earlier report, they are replaced.

    Raises:
        InputError: A file of the run is not valid, or the given nominal map has another state or command than the run,
            or the report cannot be written.
    """
    analysis = Analysis(run.checked())
    try:
        with one_blas_thread():
            drawn = drawn_figures(analysis)
            if figures or has_figures(run.folder):
                write_figures(run.folder, {figure.file: figure.drawing for figure in drawn})
            path = run.folder / "report.html"
            write_whole(path, report_html(analysis, drawn))
            return WrittenReport(path, tuple(missing_parts(analysis)))
    except OSError as error:
        raise InputError(message_of(error)) from None
