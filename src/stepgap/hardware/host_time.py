"""The computer's clock, which a test replaces by a computed time."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter, sleep


@dataclass(frozen=True)
class HostTime:
    """The computer's clock.

    Attributes:
        now: Returns the time [s].
        pause: Waits for a duration [s].
    """

    now: Callable[[], float] = perf_counter
    pause: Callable[[float], None] = sleep


COMPUTER = HostTime()
"""The clock of this computer."""
