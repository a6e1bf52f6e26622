"""What a deployment may find out about its robot."""

from typing import Final, NamedTuple

ALARM_SOURCES: Final = ("changed", "earlier", "nominal", "other_robot")
"""Values of `Alarm.source`; the last two are in the summaries of former versions only."""

_FOUND: Final = {
    "changed": "the robot was not the same as before: what had changed was learned from then on",
    "nominal": "the residual was worse than none, by the rules of a former version",
    "earlier": "the robot was again as before",
    "other_robot": "it was judged again which earlier runs are of this robot, by the rules of a former version",
}


class Alarm(NamedTuple):
    """The robot was found to be another one than before.

    Attributes:
        step: Number of the step that showed it.
        source: `changed`, or `earlier` if the robot is again as it was before a change.
    """

    step: int
    source: str

    @property
    def sentence(self) -> str:
        """What it means, without a full stop."""
        return f"after step {self.step}, {_FOUND[self.source]} (docs/learning.md)"
