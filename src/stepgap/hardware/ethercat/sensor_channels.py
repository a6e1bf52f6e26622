"""Sensors of a bus: their values in the last frame, in the sense and from the zero of the settings."""

from stepgap.hardware.ethercat.bus import Bus
from stepgap.hardware.ethercat.pdo import Packing
from stepgap.hardware.ethercat.rig_settings import BusSettings, Encoder, ForceSensor, Motor
from stepgap.hardware.ethercat.sensor_doubts import LONGEST_CONTRADICTION, PositionTrack, SensorDoubt, with_position


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
        self.slave, self._encoder = settings.position(encoder.slave), encoder
        self._name = "position" if isinstance(encoder, Motor) else "counter"
        packing = Packing(settings.pdo_set(settings.slaves[self.slave]).inputs)
        self._bits, self._count = packing.mapping[self._name][0].bits, 0
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
        self.slave, self._sensor = settings.position(sensor.slave), sensor
        self.doubt: SensorDoubt | None = None

    def value(self, bus: Bus) -> float:
        """Updates the doubt from the last good frame and returns its force [N]."""
        inputs = bus.inputs(self.slave)
        self.doubt = SensorDoubt.STATUS if inputs.get("status", 0) & self._sensor.error_bits else None
        return self._sensor.newton_per_count * (inputs["force"] - self._sensor.zero)
