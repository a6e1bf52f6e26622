"""A rig without hardware whose sensors never change: what the machine itself can do is measured with it."""

from stepgap.rigs.rig import Reading, Rig, SensorModel, Torques


class StillRig(Rig):
    """Gives the same reading at every tick and takes any torque.

    Args:
        layout: How to read the counts.
        reading: The counts.
    """

    def __init__(self, layout: SensorModel, reading: Reading):
        self._layout, self._reading = layout, reading

    @property
    def sensor_model(self) -> SensorModel:
        """How to read the counts."""
        return self._layout

    def connect(self) -> None:
        """There is nothing to connect."""

    def read(self) -> Reading:
        """Always the same."""
        return self._reading

    def write(self, torques: Torques) -> Torques:
        """Nothing moves; the torques as asked [N·m]."""
        return torques

    def close(self) -> None:
        """There is nothing to close."""
