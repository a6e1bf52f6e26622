"""Reports: figures and page of a run, and the comparison of several runs.

A report is made from a finished record alone: the run folder as `records.run_folder` reads it, and a `run_context` with
the nominal map and the motions. Nothing here builds a plant or a twin.

`learned` reads the learned residual; `reference_gait` computes the limit cycles. `run_figures` draws the figures, which
`figures` and the modules named after a figure make; `error_table`, `learned_table` and `settings_table` make the
tables, `sentences` the text, `replay_view` the replay. `page` puts all on one page, next to published results, and
`missing_parts` lists the missing parts. `comparison` makes the page of several runs, and the package `sweep` the report
of a sweep. `fit`, `fit_results` and `model_application` are the output of `stepgap fit`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from stepgap.base.blas import one_blas_thread
from stepgap.base.files import write_whole
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord, read_run_folder
from stepgap.report.comparison import comparison_html
from stepgap.report.drawing import write_figures
from stepgap.report.learned import LearnedResidual, described_residual
from stepgap.report.missing_parts import missing_parts
from stepgap.report.page import report_html
from stepgap.report.reference_gait import ReferenceGait, reference_gait
from stepgap.report.run_context import NO_CONTEXT, RunContext
from stepgap.report.run_figures import draw_run_figures

__all__ = [
    "NO_CONTEXT",
    "FolderReport",
    "RunContext",
    "RunRecord",
    "WrittenReport",
    "comparison_html",
    "read_run_folder",
    "write_report",
]


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
        write: Writes the report of such a folder into it.
    """

    holds: Callable[[Path], bool]
    write: Callable[[Path], WrittenReport]


def write_report(record: RunRecord, context: RunContext = NO_CONTEXT) -> WrittenReport:
    """Writes `figures/*.png`, `figures/*.pdf` and `report.html` of a run, whether or not it is finished.

    Each file is replaced atomically: readers see the old or the new content, never a part.

    Args:
        record: The run; the files are written into its folder.
        context: Information that is not in the files of the run.

    Raises:
        ValueError: The nominal map has another state or command than the run.
        OSError: A file cannot be read or written.
    """
    with one_blas_thread():
        learned = _learned(record, context)
        gait = _gait(record, context, learned)
        bounds = None if isinstance(context.nominal, Missing) else context.nominal.space
        drawings = draw_run_figures(record, learned, gait, bounds)
        wanted = {f"map_{index}": f"map_{name}" for index, name in enumerate(record.space.state_names)}
        write_figures(record.folder, {wanted.get(name, name): drawing for name, drawing in drawings.items()})
        path = record.folder / "report.html"
        write_whole(path, report_html(record, drawings, context, learned, gait))
        return WrittenReport(path, tuple(missing_parts(record, context, learned, gait)))


def _learned(record: RunRecord, context: RunContext) -> LearnedResidual | Missing:
    """The last learned residual, or the reason why it is left out."""
    try:
        return described_residual(record, context.final)
    except ValueError as error:
        return Missing(str(error))


def _gait(record: RunRecord, context: RunContext, learned: LearnedResidual | Missing) -> ReferenceGait | Missing:
    """Limit cycles at the targets, or the reason why they are not known."""
    if isinstance(context.nominal, Missing):
        return context.nominal
    if not len(record.steps.of_iteration(record.shown_iterations[-1]).tracking()):
        return Missing("no target was tracked yet")
    return reference_gait(record, context.nominal, learned)
