"""A hopper that stands still, without hardware; it serves to measure the timing of the computer alone."""

from stepgap.hardware.commissioning.still_rig import StillRig
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel


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
