"""What a report shows that a run folder does not hold by itself; whoever knows all settings gives it."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from stepgap.report.motion import Replay
from stepgap.step import StepMap


@dataclass(frozen=True, eq=False)
class Background:
    """A text instead of a thing says why it is missing.

    Attributes:
        plant: What executed the steps, in words.
        defaults: Every setting as it is by default, tables within tables like those of `experiment.toml`.
        nominal: Map of the physics model.
        replay: How the first and the last deployment moved.
    """

    plant: str = "simulated twin"
    defaults: Mapping[str, Any] | str = "Which settings differ from their defaults is not known here."
    nominal: StepMap | str = "The nominal map is not known here, so nothing is said of gaits."
    replay: Replay | str = "No replay was made."


BARE = Background()
"""Nothing but the run folder is known."""
