"""Limits of consecutive bad ticks, beyond which a rig must stop."""

from dataclasses import dataclass

from stepgap.base.ranges import require


@dataclass(frozen=True, kw_only=True)
class RigLimits:
    """Limits of consecutive bad ticks; each robot adds the limits of its motors and joints.

    Attributes:
        lost_frames: Largest number of consecutive lost frames.
        stale_ticks: Largest number of consecutive ticks that repeat the reading of the tick before.
        late_ticks: Largest number of consecutive missed ticks.
        simulated: The robot is a simulation, which may get torque from a computer without real-time privileges and
            without a proven watchdog.
    """

    lost_frames: int = 2
    stale_ticks: int = 2
    late_ticks: int = 2
    simulated: bool = False

    def __post_init__(self) -> None:
        for name, most in (("lost_frames", 5), ("stale_ticks", 5), ("late_ticks", MOST_LATE_TICKS)):
            require(0 <= getattr(self, name) <= most, name, getattr(self, name), f"lie between 0 and {most}")

    def without_effect(self) -> tuple[str, ...]:
        """Names of the limits that limit nothing, which a simulation may have, but no robot that gets torque."""
        return ()


MOST_LATE_TICKS = 50  # Largest value of `late_ticks`
