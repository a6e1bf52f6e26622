"""The sensors of the twin: how to read their counts, known from its settings alone."""

from math import inf

from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.robots.hopper.twin.reality_gap import RealityGap

EXACT_COUNTS = 16384
"""Counts per turn of a sensor without quantisation; the twin does not round them."""


def twin_sensor_model(robot: RobotParameters, gap: RealityGap, tick: float = 1e-3) -> HopperSensorModel:
    """How to read the counts of a twin; all zeros are at angle 0.

    Args:
        robot: What the physics model takes the robot to be.
        gap: How the twin differs from it.
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
    """Counts per turn, also of a sensor without quantisation."""
    return counts if counts < inf else EXACT_COUNTS
