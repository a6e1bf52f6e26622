"""What a report shows besides the files of a run; the caller, who knows the robot, gives it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stepgap.records.missing import Missing
from stepgap.report.motion import Replay
from stepgap.step import StepMap


@dataclass(frozen=True, eq=False)
class RunContext:
    """What is known of a run besides its files; by default nothing.

    Attributes:
        plant: Name of what executed the steps.
        defaults: Default value of every setting, in nested tables like those of `experiment.toml`.
        nominal: Map of the physics model.
        replay: Motion of the first and of the last deployment.
    """

    plant: str = "simulated twin"
    defaults: Mapping[str, Any] | Missing = Missing("the default settings were not given")
    nominal: StepMap | Missing = Missing("the nominal map was not given")
    replay: Replay | Missing = Missing("no motion was given")


NO_CONTEXT = RunContext()
"""Nothing but the files of the run is known."""
