"""All figures of a run; matplotlib is imported when they are drawn, so that a report without it lacks only these."""

from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.report.drawing import Drawing, draw_figure
from stepgap.report.learned import LearnedResidual
from stepgap.report.reference_gait import ReferenceGait, centre_of
from stepgap.step import StepSpace

Drawings = dict[str, Drawing | Missing]
"""Figures, or the reasons why there are none, by their names in `report_html`."""


def draw_run_figures(
    record: RunRecord, learned: LearnedResidual | Missing, gait: ReferenceGait | Missing, bounds: StepSpace | None
) -> Drawings:
    """Draws the figures of a run.

    Args:
        record: The run.
        learned: The last residual, or the reason why there is none.
        gait: Limit cycles at the targets, or the reason why they are not known.
        bounds: State and command with their bounds; None if these are not known.
    """
    drawings = _of_steps(record, bounds)
    if isinstance(learned, LearnedResidual) and learned.steps:
        drawings |= _of_residual(record.space, learned, gait)
    if isinstance(gait, ReferenceGait) and (len(gait.space.state), len(gait.space.command)) == (2, 2):
        drawings["gait"] = _of_gait(gait)
    return drawings


def _of_steps(record: RunRecord, bounds: StepSpace | None) -> Drawings:
    def tracking() -> object:
        from stepgap.report.figures import tracking_figure

        return tracking_figure(record)

    def commands() -> object:
        from stepgap.report.figures import command_figure

        return command_figure(record, bounds)

    def errors() -> object:
        from stepgap.report.figures import error_figure

        return error_figure(record)

    def state_errors() -> object:
        from stepgap.report.state_figure import state_error_figure

        return state_error_figure(record)

    def map_of(index: int) -> object:
        from stepgap.report.figures import map_figure

        return map_figure(record, index)

    drawings = {
        "tracking": draw_figure(tracking, "the tracking"),
        "commands": draw_figure(commands, "the commands"),
        "errors": draw_figure(errors, "the errors"),
        "state_errors": draw_figure(state_errors, "the errors against state and command"),
    }
    for index, name in enumerate(record.space.state_names):
        drawings[f"map_{index}"] = draw_figure(lambda index=index: map_of(index), f"the map of {name}")
    return drawings


def _of_residual(space: StepSpace, learned: LearnedResidual, gait: ReferenceGait | Missing) -> Drawings:
    def left_out() -> object:
        from stepgap.report.learned_figure import left_out_figure

        return left_out_figure(space, learned)

    def surface() -> object:
        from stepgap.report.surface_figure import surface_figure

        return surface_figure(space, learned, centre_of(learned, gait))

    return {
        "left_out": draw_figure(left_out, "the leave-one-out residuals"),
        "surface": draw_figure(surface, "the correction"),
    }


def _of_gait(gait: ReferenceGait) -> Drawing | Missing:
    def reachable() -> object:
        from stepgap.report.gait import reference_gait_figure

        return reference_gait_figure(gait)

    return draw_figure(reachable, "the reachable set")
