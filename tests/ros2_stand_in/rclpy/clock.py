"""The steady clock: the time of the simulated robot."""

from enum import Enum
from types import SimpleNamespace

from rclpy import world


class ClockType(Enum):
    """Kinds of clocks."""

    STEADY_TIME = 3


class Clock:
    """A clock."""

    def __init__(self, *, clock_type: ClockType):
        assert clock_type == ClockType.STEADY_TIME

    def now(self) -> SimpleNamespace:
        """The time, in nanoseconds."""
        return SimpleNamespace(nanoseconds=round(world.ROBOT.time * 1e9))
