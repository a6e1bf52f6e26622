"""The sensor model from the settings alone equals that of the twin."""

from math import inf

import numpy as np
import pytest

from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model


@pytest.mark.parametrize("gap", [RealityGap(), RealityGap.none(), RealityGap(motor_counts=inf, boom_pivot_height=0.45)])
def test_the_sensor_model_is_that_of_the_twin(gap: RealityGap) -> None:
    robot, tick = RobotParameters(), 5e-4
    assert twin_sensor_model(robot, gap, tick) == Twin(robot, gap, np.random.default_rng(0), tick).sensor_model


def test_counts_are_those_of_the_settings() -> None:
    model = twin_sensor_model(RobotParameters(boom_length=1.7), RealityGap(motor_counts=4096, boom_counts_vertical=inf))
    assert (model.boom_length, model.motor_counts, model.boom_counts_vertical) == (1.7, 4096, 16384)
