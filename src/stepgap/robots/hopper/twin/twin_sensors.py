"""Sensor model of the twin, which follows from its settings alone."""

from math import inf

from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.sensors import HopperSensorModel
from stepgap.robots.hopper.twin.reality_gap import RealityGap

EXACT_COUNTS = 16384  # Counts per turn of a sensor without quantisation; the twin does not round them


def twin_sensor_model(robot: RobotParameters, gap: RealityGap, tick: float = 1e-3) -> HopperSensorModel:
    """Sensor model of a twin; all zeros are at angle 0.

    Args:
        robot: Robot of the physics model.
        gap: Differences of the twin from it.
        tick: Time from one read to the next [s].
    """
    return HopperSensorModel(
        tick=tick,
        boom_length=robot.boom_length,
        pivot_height=gap.boom_pivot_height,
        motor_counts=_finite(gap.motor_counts),
        boom_counts_horizontal=_finite(gap.boom_counts_horizontal),
        boom_counts_vertical=_finite(gap.boom_counts_vertical),
        touchdown_force=gap.touchdown_force,
        takeoff_length=gap.takeoff_length,
    )


def _finite(counts: float) -> float:
    """Counts per turn; EXACT_COUNTS for a sensor without quantisation."""
    return counts if counts < inf else EXACT_COUNTS
