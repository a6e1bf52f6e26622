"""Reports: figures and page of a run, and the comparison of several runs.

A report is made from a finished record alone: the run folder as `records.run_folder` reads it, and a `run_context` with
the nominal map and the motions. Nothing here builds a plant or a twin.

`learned` reads the learned residual; `reference_gait` computes the limit cycles. `figures`, `learned_figure` and `gait`
make the figures, `error_table`, `learned_table` and `settings_table` the tables, `sentences` the text, `replay_view`
the replay. `page` puts all on one page, next to the paper's results, and `missing_parts` lists the missing parts.
`comparison` makes the page of several runs, and the package `sweep` the report of a sweep.
"""

from pathlib import Path
from typing import NamedTuple

from stepgap.base.files import write_whole
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord, read_run_folder
from stepgap.report.comparison import comparison_html
from stepgap.report.drawing import Drawing, draw_figure, write_figures
from stepgap.report.learned import LearnedResidual, read_learned_residual
from stepgap.report.missing_parts import missing_parts
from stepgap.report.page import report_html
from stepgap.report.reference_gait import ReferenceGait, centre_of, reference_gait
from stepgap.report.run_context import NO_CONTEXT, RunContext
from stepgap.step import StepSpace

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
        missing: Missing parts, each with the reason in brackets.
    """

    path: Path
    missing: tuple[str, ...]


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
    learned, damage = _learned(record)
    gait = _gait(record, context, learned)
    bounds = None if isinstance(context.nominal, Missing) else context.nominal.space
    drawings = _drawings(record, learned, gait, bounds)
    wanted = {f"map_{index}": f"map_{name}" for index, name in enumerate(record.space.state_names)}
    write_figures(record.folder, {wanted.get(name, name): drawing for name, drawing in drawings.items()})
    path = record.folder / "report.html"
    write_whole(path, report_html(record, drawings, context, learned, gait))
    return WrittenReport(path, tuple(missing_parts(record, context, learned, gait, damage)))


def _learned(record: RunRecord) -> tuple[LearnedResidual | None, str]:
    """The last learned residual, and what is wrong with its file, for which it is left out."""
    try:
        return read_learned_residual(record.folder, record.shown_iterations[-1], record.space), ""
    except ValueError as error:
        return None, str(error)


def _gait(record: RunRecord, context: RunContext, learned: LearnedResidual | None) -> ReferenceGait | Missing:
    """Limit cycles at the targets, or the reason why they are not known."""
    if isinstance(context.nominal, Missing):
        return context.nominal
    if not len(record.steps.of_iteration(record.shown_iterations[-1]).tracking()):
        return Missing("no target was tracked yet")
    return reference_gait(record, context.nominal, learned)


def _drawings(
    record: RunRecord, learned: LearnedResidual | None, gait: ReferenceGait | Missing, bounds: StepSpace | None
) -> dict[str, Drawing | Missing]:
    """All figures of a run by their names in `report_html`."""

    def tracking() -> object:
        from stepgap.report.figures import tracking_figure

        return tracking_figure(record)

    def commands() -> object:
        from stepgap.report.figures import command_figure

        return command_figure(record, bounds)

    def errors() -> object:
        from stepgap.report.figures import error_figure

        return error_figure(record)

    def map_of(index: int) -> object:
        from stepgap.report.figures import map_figure

        return map_figure(record, index)

    def state_errors() -> object:
        from stepgap.report.state_figure import state_error_figure

        return state_error_figure(record)

    drawings = {
        "tracking": draw_figure(tracking, "the tracking"),
        "commands": draw_figure(commands, "the commands"),
        "errors": draw_figure(errors, "the errors"),
        "state_errors": draw_figure(state_errors, "the errors against state and command"),
    }
    for index, name in enumerate(record.space.state_names):
        drawings[f"map_{index}"] = draw_figure(lambda index=index: map_of(index), f"the map of {name}")
    if learned is not None and learned.steps:

        def left_out() -> object:
            from stepgap.report.learned_figure import left_out_figure

            return left_out_figure(record.space, learned)

        def surface() -> object:
            from stepgap.report.surface_figure import surface_figure

            return surface_figure(record.space, learned, centre_of(learned, gait))

        drawings["left_out"] = draw_figure(left_out, "the leave-one-out residuals")
        drawings["surface"] = draw_figure(surface, "the correction")
    if isinstance(gait, ReferenceGait) and (len(gait.space.state), len(gait.space.command)) == (2, 2):

        def reachable() -> object:
            from stepgap.report.gait import reference_gait_figure

            return reference_gait_figure(gait)

        drawings["gait"] = draw_figure(reachable, "the reachable set")
    return drawings
