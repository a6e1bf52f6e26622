"""What a deployment may find out about its robot."""

from typing import Final, NamedTuple

ALARM_SOURCES: Final = ("changed", "earlier", "nominal", "other_robot")
"""Values of `Alarm.source`; the last two are in the summaries of former versions only."""


class Alarm(NamedTuple):
    """The robot was found to be another one than before.

    Attributes:
        step: Number of the step that showed it.
        source: `changed`, or `earlier` if the robot is again as it was before a change.
    """

    step: int
    source: str
