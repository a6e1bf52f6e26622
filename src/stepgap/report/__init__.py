"""What people look at: figures and the report of a run, and the comparison of several.

A report is made from a finished record alone: the run folder as `records.run_folder` reads it, and a `run_context` with
the nominal map and the motions. Nothing here builds a plant or a twin.

`learnt` reads what the run learnt; `reference_gait` finds its limit cycles. `figures`, `learnt_figure` and `gait` draw,
`error_table`, `learnt_table` and `settings_table` are the numbers, `sentences` the text, `replay_view` the motion;
`page` puts all on one page, beside the numbers of the `paper`, and `missing_parts` lists what it does without.
`comparison` is the page of several runs.
"""

import re
from collections.abc import Container
from pathlib import Path
from typing import NamedTuple

from stepgap.base.files import write_whole
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord, read_run_folder
from stepgap.report.comparison import comparison_html
from stepgap.report.drawing import Drawing, draw_figure
from stepgap.report.learnt import Learnt, read_learnt
from stepgap.report.missing_parts import missing_parts
from stepgap.report.page import report_html
from stepgap.report.reference_gait import ReferenceGait, reference_gait
from stepgap.report.run_context import NO_CONTEXT, RunContext

__all__ = [
    "NO_CONTEXT",
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
        missing: Parts that it does without, each with the reason in brackets.
    """

    path: Path
    missing: tuple[str, ...]


def write_report(record: RunRecord, context: RunContext = NO_CONTEXT) -> WrittenReport:
    """Writes `figures/*.png`, `figures/*.pdf` and `report.html` of a run, whether or not it is finished.

    A reader of these files sees the old ones or the new ones, never a part.

    Args:
        record: The run; the files are written into its folder.
        context: What is known of the run besides its files.

    Raises:
        ValueError: The model in the folder is not one of this run, or the nominal map is of another state or command.
        OSError: A file cannot be read or written.
    """
    learnt = read_learnt(record.folder, record.shown_iterations[-1], record.space)
    gait = _gait(record, context, learnt)
    drawings = _drawings(record, learnt, gait)
    names: list[str] = []
    for name, drawing in drawings.items():
        number = name.removeprefix("map_")
        wanted = f"map_{record.space.state_names[int(number)]}" if number != name else name
        names.append(_file_name(wanted, names))
        if isinstance(drawing, Drawing):
            write_whole(record.folder / "figures" / f"{names[-1]}.png", drawing.png)
            write_whole(record.folder / "figures" / f"{names[-1]}.pdf", drawing.pdf)
    path = record.folder / "report.html"
    write_whole(path, report_html(record, drawings, context, learnt, gait))
    return WrittenReport(path, tuple(missing_parts(record, context, learnt, gait)))


def _gait(record: RunRecord, context: RunContext, learnt: Learnt | None) -> ReferenceGait | Missing:
    """Limit cycles at the targets, or why they are not known."""
    if isinstance(context.nominal, Missing):
        return context.nominal
    if not len(record.steps.of_iteration(record.shown_iterations[-1]).tracking()):
        return Missing("no target was tracked yet")
    return reference_gait(record, context.nominal, learnt)


def _drawings(record: RunRecord, learnt: Learnt | None, gait: ReferenceGait | Missing) -> dict[str, Drawing | Missing]:
    """Every figure of a run by its name in `report_html`."""

    def tracking() -> object:
        from stepgap.report.figures import tracking_figure

        return tracking_figure(record)

    def errors() -> object:
        from stepgap.report.figures import error_figure

        return error_figure(record)

    def map_of(index: int) -> object:
        from stepgap.report.figures import map_figure

        return map_figure(record, index)

    drawings = {"tracking": draw_figure(tracking, "the tracking"), "errors": draw_figure(errors, "the errors")}
    for index, name in enumerate(record.space.state_names):
        drawings[f"map_{index}"] = draw_figure(lambda index=index: map_of(index), f"the map of {name}")
    if learnt is not None and learnt.steps:

        def left_out() -> object:
            from stepgap.report.learnt_figure import left_out_figure

            return left_out_figure(record.space, learnt)

        drawings["left_out"] = draw_figure(left_out, "the leave-one-out residuals")
    if isinstance(gait, ReferenceGait) and (len(gait.space.state), len(gait.space.command)) == (2, 2):

        def reached() -> object:
            from stepgap.report.gait import reference_gait_figure

            return reference_gait_figure(gait)

        drawings["gait"] = draw_figure(reached, "the reachable set")
    return drawings


def _file_name(wanted: str, taken: Container[str]) -> str:
    """A name that every file system takes and that is not taken yet."""
    name = re.sub(r"[^a-z0-9_-]", "_", wanted.lower())[:60]
    while name in taken:
        name += "_"
    return name
