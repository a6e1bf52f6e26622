"""Information for a report that is not in the files of a run; it is given by the caller, who knows the robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stepgap.learning.residual import Residual
from stepgap.records.missing import Missing
from stepgap.report.motion import Replay
from stepgap.step import StepMap


@dataclass(frozen=True, eq=False)
class RunContext:
    """Information on a run that is not in its files; by default there is none.

    Attributes:
        plant: Name of the plant that executed the steps.
        defaults: Default value of every setting, in nested tables like those of `experiment.toml`.
        nominal: Map of the physics model.
        replay: Motions of the first and of the last deployment.
        final: Residual fitted to all steps, of a run whose deployment 0 learned from the nominal map on; it is not in
            the files of the run, which have the residuals at the start of deployments.
    """

    plant: str = "simulated twin"
    defaults: Mapping[str, Any] | Missing = Missing("the default settings were not given")
    nominal: StepMap | Missing = Missing("the nominal map was not given")
    replay: Replay | Missing = Missing("no motion was given")
    final: Residual | Missing = Missing("the residual after the last deployment was not given")


NO_CONTEXT = RunContext()
"""Context of a run of which only the files are known."""
