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
    return StillRig(sensors, HopperReading(2048, -2048, 0, 400, 0.0))
