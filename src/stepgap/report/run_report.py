"""The report of a run: figures and page."""

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError, message_of
from stepgap.base.files import write_whole
from stepgap.experiment.displays import WrittenReport
from stepgap.experiment.run import Run
from stepgap.report.analysis import Analysis
from stepgap.report.drawing import has_figures, write_figures
from stepgap.report.figures import drawn_figures
from stepgap.report.page import missing_parts, report_html


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
