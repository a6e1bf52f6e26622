"""Information for a report that is not in the files of a run; it is given by the caller, who knows the robot."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

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
    """

    plant: str = "simulated twin"
    defaults: Mapping[str, Any] | Missing = Missing("the default settings were not given")
    nominal: StepMap | Missing = Missing("the nominal map was not given")
    replay: Replay | Missing = Missing("no motion was given")


NO_CONTEXT = RunContext()
"""Context of a run of which only the files are known."""
