"""A hopper that stands still, without hardware; it serves to measure the timing of the computer alone."""

from stepgap.rigs.rig import Reading, Rig, SensorModel, Torques
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel


class StillRig(Rig):
    """Returns the same reading, in counts, at every tick and accepts any torque."""

    def __init__(self, sensor_model: SensorModel, reading: Reading):
        self._sensor_model = sensor_model
        self._reading = reading

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


def still_hopper(tick: float) -> StillRig:
    """Rig with a tick [s] and the same sensor values at every tick, those of a leg that hangs in the air."""
    sensors = HopperSensorModel(
        tick=tick,
        boom_length=RobotParameters().boom_length,
        pivot_height=0.4,
        motor_counts=16384,
        boom_counts_horizontal=5000,
        boom_counts_vertical=16384,
        touchdown_force=5.0,
        takeoff_length=0.273,
    )
    reading = HopperReading(motor_1=2048, motor_2=-2048, boom_horizontal=0, boom_vertical=400, contact_force=0.0)
    return StillRig(sensors, reading)
