"""The layout of the sensors that is known without a twin is that of the twin."""

from math import inf

import numpy as np
import pytest

from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.sensors import sensor_layout
from stepgap.robots.hopper.twin.twin import Twin


@pytest.mark.parametrize("gap", [RealityGap(), RealityGap.none(), RealityGap(motor_counts=inf, boom_pivot_height=0.45)])
def test_the_layout_is_that_of_the_twin(gap: RealityGap) -> None:
    robot, tick = RobotParameters(), 5e-4
    assert sensor_layout(robot, gap, tick) == Twin(robot, gap, np.random.default_rng(0), tick).layout


def test_counts_are_those_of_the_settings() -> None:
    layout = sensor_layout(RobotParameters(boom_length=1.7), RealityGap(motor_counts=4096, boom_counts_vertical=inf))
    assert (layout.boom_length, layout.motor_counts, layout.boom_counts_vertical) == (1.7, 4096, 16384)
