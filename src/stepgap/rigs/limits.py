"""How many bad ticks in a row a rig may have before it must stop."""

from dataclasses import dataclass

from stepgap.base.ranges import require


@dataclass(frozen=True, kw_only=True)
class RigLimits:
    """Budgets of bad ticks; each robot adds what its motors and joints may do.

    Attributes:
        lost_frames: Frames in a row that may be lost.
        stale_ticks: Ticks in a row whose reading may be that of the tick before.
        late_ticks: Ticks in a row that may be missed.
    """

    lost_frames: int = 2
    stale_ticks: int = 2
    late_ticks: int = 2

    def __post_init__(self) -> None:
        for name, most in (("lost_frames", 5), ("stale_ticks", 5), ("late_ticks", MOST_LATE_TICKS)):
            require(0 <= getattr(self, name) <= most, name, getattr(self, name), f"lie between 0 and {most}")


MOST_LATE_TICKS = 50
"""Largest budget of missed ticks in a row."""
