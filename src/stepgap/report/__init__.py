"""What people look at: figures and the report of a run, and the comparison of several.

`run_folder` reads a run, with its `summary`, and `learnt` what it learnt; `reference_gait` finds its limit cycles.
`figures`, `learnt_figure` and `gait` draw, `error_table`, `learnt_table` and `settings_table` are the numbers, `words`
the sentences, `replay_view` the motion; `page` puts all on one page, beside the numbers of the `paper`.
`comparison` is the page of several runs.
"""

import re
from collections.abc import Container
from pathlib import Path

from stepgap.base.files import write_whole
from stepgap.records.run_folder import RunRecord, read_run_folder
from stepgap.report.background import BARE, Background
from stepgap.report.comparison import comparison_html
from stepgap.report.drawing import Drawing, draw
from stepgap.report.learnt import Learnt, read_learnt
from stepgap.report.page import report_html
from stepgap.report.reference_gait import ReferenceGait, reference_gait
from stepgap.step import StepSpace

__all__ = ["Background", "RunRecord", "comparison_html", "read_run_folder", "write_report"]


def write_report(folder: Path, space: StepSpace | None = None, background: Background = BARE) -> Path:
    """Writes `figures/*.png`, `figures/*.pdf` and `report.html` of a run, whether or not it is finished.

    A reader of these files sees the old ones or the new ones, never a part.

    Args:
        folder: The run folder.
        space: Names and units of state and command; by default those of the header of `steps.csv`.
        background: What else is known of the run.

    Returns:
        Path of the report.

    Raises:
        ValueError: A file of the run is not what it must be; the message names it and says what would be right.
        OSError: A file cannot be read or written.
    """
    record = read_run_folder(folder, space)
    learnt = read_learnt(folder, record.shown[-1], record.space)
    gait = _gait(record, background, learnt)
    drawings = _drawings(record, learnt, gait)
    names: list[str] = []
    for name, drawing in drawings.items():
        number = name.removeprefix("map_")
        wanted = f"map_{record.space.state_names[int(number)]}" if number != name else name
        names.append(_file_name(wanted, names))
        if isinstance(drawing, Drawing):
            write_whole(folder / "figures" / f"{names[-1]}.png", drawing.png)
            write_whole(folder / "figures" / f"{names[-1]}.pdf", drawing.pdf)
    path = folder / "report.html"
    write_whole(path, report_html(record, drawings, background, learnt, gait))
    return path


def _gait(record: RunRecord, background: Background, learnt: Learnt | None) -> ReferenceGait | str:
    """Limit cycles at the targets, or why they are not known."""
    if isinstance(background.nominal, str):
        return background.nominal
    if not len(record.steps.of_iteration(record.shown[-1]).tracking()):
        return "No target was tracked yet, so nothing is said of gaits."
    return reference_gait(record, background.nominal, learnt)


def _drawings(record: RunRecord, learnt: Learnt | None, gait: ReferenceGait | str) -> dict[str, Drawing | str]:
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

    drawings = {"tracking": draw(tracking, "the tracking"), "errors": draw(errors, "the errors")}
    for index, name in enumerate(record.space.state_names):
        drawings[f"map_{index}"] = draw(lambda index=index: map_of(index), f"the map of {name}")
    if learnt is not None and learnt.steps:

        def left_out() -> object:
            from stepgap.report.learnt_figure import left_out_figure

            return left_out_figure(record.space, learnt)

        drawings["left_out"] = draw(left_out, "the leave-one-out residuals")
    if isinstance(gait, ReferenceGait) and (len(gait.space.state), len(gait.space.command)) == (2, 2):

        def reached() -> object:
            from stepgap.report.gait import reference_gait_figure

            return reference_gait_figure(gait)

        drawings["gait"] = draw(reached, "the reachable set")
    return drawings


def _file_name(wanted: str, taken: Container[str]) -> str:
    """A name that every file system takes and that is not taken yet."""
    name = re.sub(r"[^a-z0-9_-]", "_", wanted.lower())[:60]
    while name in taken:
        name += "_"
    return name
