"""What a report computes from a run: its learned residual, its limit cycles and its measured closed loops.

The limit cycles at the targets and the one-step reachable sets are those of the nominal and of the corrected map.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import final

import numpy as np

from stepgap.experiment.run import Run
from stepgap.learning.residual import HistoryInputs, join_points
from stepgap.records.missing import Missing
from stepgap.records.motion_file import Replay
from stepgap.report.learned_residual import LearnedResidual
from stepgap.report.measured_loop import MeasuredLoop, measured_loop
from stepgap.report.reasons import Reason, reasons
from stepgap.report.reference_gait import ReferenceGait, reference_gait
from stepgap.step import Array, Quantity, StepSpace


@final
@dataclass(frozen=True, eq=False)
class Analysis:
    """What a report computes from a run, each part when it is first used.

    Attributes:
        run: The run, which has at least one step.
    """

    run: Run

    @cached_property
    def learned(self) -> LearnedResidual | Missing:
        """The residual with which the last deployment began.

        If that is deployment 0, and it learned from the nominal map on, it is that of a further deployment.
        """
        if not self.run.has_unsaved_residual:
            last = self.run.shown_iterations[-1]
            residual = self.run.residual(last)
            return residual if isinstance(residual, Missing) else LearnedResidual(last, residual)
        final = self.run.final
        if isinstance(final, Missing):
            return Missing(f"deployment 0 learned while it ran, but what it learned is not known: {final.reason}")
        return LearnedResidual(1, final)

    @property
    def has_learned_steps(self) -> bool:
        """Whether the learned residual is known and keeps the steps to which it was fitted."""
        return not isinstance(self.learned, Missing) and self.learned.steps > 0

    @cached_property
    def replay(self) -> Replay | Missing:
        """Motions of the first and of the last deployment; they are kept in `replay/` of the folder."""
        from stepgap.experiment.replay import replay_of  # only where it is used: it imports plants

        return replay_of(self.run)

    @cached_property
    def gait(self) -> ReferenceGait | Missing:
        """Limit cycles at the targets of the last deployment.

        Raises:
            InputError: The nominal map has another state or command than the run.
        """
        if isinstance(self.run.nominal, Missing):
            return self.run.nominal
        if not self.run.steps.of_iteration(self.run.shown_iterations[-1]).tracking().tracked:
            return Missing("no target was tracked yet")
        return reference_gait(self.run, self.run.nominal, self.learned)

    @cached_property
    def reasons(self) -> list[Reason]:
        """Why it did not track, for the first screen."""
        return reasons(self.run)

    @cached_property
    def loops(self) -> list[MeasuredLoop | None]:
        """The measured closed loop of each finished deployment; None where it is not known."""
        return [measured_loop(self.run.steps.of_iteration(deployment.iteration)) for deployment in self.run.deployments]


def input_quantities(space: StepSpace, history_inputs: HistoryInputs) -> list[Quantity]:
    """Names and units of a residual's inputs."""
    context = space.context_inputs[: history_inputs.context_inputs]
    scaled = [Quantity(quantity.name, f"{quantity.input_scale:g} {quantity.unit}", -1, 1) for quantity in context]
    time = [Quantity("time", "forgetting times", -1, 1)] if history_inputs.timed else []
    return [*space.state, *space.command, *scaled, *time]


def centre_of(learned: LearnedResidual, gait: object) -> Array:
    """State and command of the limit cycle on the corrected map at the central target; shape (n + m,).

    If the gait is not known, it is the median of the points to which the residual was fitted.

    Args:
        gait: A `ReferenceGait`, or anything else if it is not known.
    """
    n, m = learned.residual.sizes
    if isinstance(gait, ReferenceGait):
        point = gait.centre_point
        if point is not None:
            return join_points(point.state, point.command)
    return np.median(learned.residual.regressions[0].points[:, : n + m], axis=0)
