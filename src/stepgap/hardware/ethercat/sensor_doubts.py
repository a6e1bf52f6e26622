"""What a bus itself reports about a sensor: errors in a terminal's status word, and the velocity beside a position."""

from enum import Enum
from typing import NamedTuple

LONGEST_CONTRADICTION = 8
"""Number of readings in a row in which position and velocity may contradict each other.

The velocity of a drive is filtered, so that it follows some readings later.
"""

LARGEST_REST, LEAST_MOVEMENT = 1.0, 5.0
"""Movements in a reading, by position or velocity, up to which a motor stands still, and from which it moves [counts].

Between them they cannot contradict each other, whatever the delay of the velocity.
"""


class SensorDoubt(Enum):
    """Reasons to doubt a sensor that the bus itself gives, with their texts for messages."""

    STATUS = "its status word reports an error"
    VELOCITY = "its position and its velocity (0x606C) contradict each other"


class PositionTrack(NamedTuple):
    """Last position of a drive.

    Attributes:
        position: Its position [counts].
        contradictions: Number of readings in a row in which position and velocity contradicted each other.
    """

    position: int
    contradictions: int = 0


def with_position(track: PositionTrack, position: int, velocity: float) -> PositionTrack:
    """Track with a reading: the position must not stand still while the velocity moves, or the reverse.

    Args:
        track: Track before.
        position: Position [counts].
        velocity: Movement in the time of a reading by the velocity of the drive [counts].
    """
    moved = abs(position - track.position)
    slower, faster = sorted((float(moved), abs(velocity)))
    contradicts = (slower <= LARGEST_REST and faster >= LEAST_MOVEMENT) or (
        (position - track.position) * velocity < 0 and slower >= LEAST_MOVEMENT
    )
    return PositionTrack(position, track.contradictions + 1 if contradicts else 0)
