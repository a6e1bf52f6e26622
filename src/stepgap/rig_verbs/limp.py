"""A real-time process that reads a robot's bus and gives it no torque."""

from functools import partial

from stepgap.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.rigs.ethercat.ethercat_rig import EthercatRig
from stepgap.rigs.ethercat.rig_settings import RigSettings
from stepgap.rigs.limp_rig import FrameCount, LimpRig
from stepgap.rigs.rig import Reading, RigLayout
from stepgap.rigs.still_rig import StillRig


def limp_setup(settings: RigSettings, robot: RobotParameters, gains: Gains, frames: FrameCount) -> RealtimeSetup:
    """The robot on its bus, limp whatever is asked.

    Args:
        settings: Of the bus.
        robot: On it.
        gains: Of the law whose torques are computed, and not written.
        frames: Counts those that are lost.
    """
    return RealtimeSetup(partial(_limp_robot, settings, robot, frames), robot, gains, CommandBounds())


def still_setup(tick: float) -> RealtimeSetup:
    """No robot and no bus, but all else of a tick [s]: the same sensor values always."""
    return RealtimeSetup(partial(_still_robot, tick), RobotParameters(), Gains(), CommandBounds())


def _limp_robot(settings: RigSettings, robot: RobotParameters, frames: FrameCount) -> LimpRig:
    return LimpRig(EthercatRig(settings, robot), settings.limits, frames)


def _still_robot(tick: float) -> StillRig:
    layout = RigLayout(
        tick=tick,
        boom_length=RobotParameters().boom_length,
        pivot_height=0.4,
        motor_counts=16384,
        boom_counts_horizontal=5000,
        boom_counts_vertical=16384,
        touchdown_force=5.0,
        takeoff_length=0.273,
    )
    return StillRig(layout, Reading(2048, -2048, 0, 400, 0.0))
