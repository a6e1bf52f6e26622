"""The functions that most tests need, loaded or compiled."""

import numpy as np

from stepgap.plants.rig_plant import RigPlant
from stepgap.robots.hopper.model.apex_map import ApexMap
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin


def compile_hops() -> None:
    """A hop of the map with its Jacobian, and one of the twin."""
    robot, bounds, step_map = RobotParameters(), CommandBounds(), ApexMap()
    centre = bounds.space().state_centre, bounds.space().command_centre
    step_map.evaluate(*centre)
    step_map.jacobian(*centre)
    twin = Twin(robot, RealityGap(), np.random.default_rng(0))
    with RigPlant(twin, HopperControl(robot, Gains(), bounds)) as plant:
        plant.start()
