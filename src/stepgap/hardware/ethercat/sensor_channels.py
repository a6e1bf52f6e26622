"""Sensors of a bus: their values in the last frame, in the sense and from the zero of the settings."""

from enum import Enum
from typing import NamedTuple

from stepgap.hardware.ethercat.bus import Bus
from stepgap.hardware.ethercat.pdo import Packing
from stepgap.hardware.ethercat.rig_settings import BusSettings, Encoder, ForceSensor, Motor

LONGEST_CONTRADICTION = 8
"""Number of readings in a row in which position and velocity may contradict each other.

The velocity of a drive is filtered, so that it follows some readings later.
"""

LARGEST_REST = 1.0  # Movement in a reading, by position or velocity, up to which a motor stands still [counts]

LEAST_MOVEMENT = 5.0
"""Movement from which it moves; between both they cannot contradict each other, whatever the delay of the velocity."""


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
        position: Position [counts].
        velocity: Movement in the time of a reading by the velocity of the drive [counts].
    """
    moved = abs(position - track.position)
    slower, faster = sorted((float(moved), abs(velocity)))
    contradicts = (slower <= LARGEST_REST and faster >= LEAST_MOVEMENT) or (
        (position - track.position) * velocity < 0 and slower >= LEAST_MOVEMENT
    )
    return PositionTrack(position, track.contradictions + 1 if contradicts else 0)


def unwrapped(raw: int, before: int, bits: int) -> int:
    """Unwraps a counter of the given number of bits: the count nearest to `before` whose lowest bits are `raw`."""
    half = 1 << (bits - 1)
    return before + ((raw - before + half) & (2 * half - 1)) - half


class EncoderChannel:
    """Counts of one encoder: unwrapped, relative to its zero, forward positive.

    Attributes:
        slave: Position of its slave on the bus.
        doubt: Reason to doubt the last value; None without one.
    """

    def __init__(self, settings: BusSettings, encoder: Encoder):
        self.slave = settings.position(encoder.slave)
        self._encoder = encoder
        self._name = "position" if isinstance(encoder, Motor) else "counter"
        packing = Packing(settings.pdo_set(settings.slaves[self.slave]).inputs)
        self._bits = packing.mapping[self._name][0].bits
        self._count = 0
        compared = encoder.velocity_unit if isinstance(encoder, Motor) and "velocity" in packing.names else 0.0
        self._velocity_unit = compared * settings.tick / settings.frames_per_tick
        self._track: PositionTrack | None = None
        self.doubt: SensorDoubt | None = None

    def value(self, bus: Bus) -> int:
        """Updates the count from the last good frame, once per frame, and returns it."""
        inputs = bus.inputs(self.slave)
        self._count = unwrapped(inputs[self._name], self._count, self._bits)
        if self._velocity_unit:
            track = self._track or PositionTrack(self._count)
            self._track = track = with_position(track, self._count, self._velocity_unit * inputs["velocity"])
            self.doubt = SensorDoubt.VELOCITY if track.contradictions > LONGEST_CONTRADICTION else None
        if inputs.get("status", 0) & self._encoder.error_bits:
            self.doubt = SensorDoubt.STATUS
        return self._encoder.sign * (self._count - self._encoder.zero)


class ForceChannel:
    """The force of one sensor.

    Attributes:
        slave: Position of its slave on the bus.
        doubt: Reason to doubt the last value; None without one.
    """

    def __init__(self, settings: BusSettings, sensor: ForceSensor):
        self.slave = settings.position(sensor.slave)
        self._sensor = sensor
        self.doubt: SensorDoubt | None = None

    def value(self, bus: Bus) -> float:
        """Updates the doubt from the last good frame and returns its force [N]."""
        inputs = bus.inputs(self.slave)
        self.doubt = SensorDoubt.STATUS if inputs.get("status", 0) & self._sensor.error_bits else None
        return self._sensor.newton_per_count * (inputs["force"] - self._sensor.zero)
