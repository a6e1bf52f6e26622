"""A rig without hardware whose sensors never change, for measuring the timing of the computer alone."""

from stepgap.rigs.rig import Reading, Rig, SensorModel, Torques


class StillRig(Rig):
    """Returns the same reading at every tick and accepts any torque.

    Args:
        sensor_model: Timing of the sensors and conversion of their counts.
        reading: The counts.
    """

    def __init__(self, sensor_model: SensorModel, reading: Reading):
        self._sensor_model, self._reading = sensor_model, reading

    @property
    def sensor_model(self) -> SensorModel:
        """Timing of the sensors and conversion of their counts."""
        return self._sensor_model

    def connect(self) -> None:
        """Does nothing: there is no hardware."""

    def read(self) -> Reading:
        """Returns the constant reading."""
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Returns the given torques [N·m]; nothing moves."""
        return torques

    def close(self) -> None:
        """Does nothing: there is no hardware."""
