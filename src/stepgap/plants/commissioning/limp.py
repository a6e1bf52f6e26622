"""A real-time process that reads a robot's bus and gives it no torque."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import sleep

import numpy as np

from stepgap.base.signals import terminated_as_interrupted
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.session import Session
from stepgap.plants.realtime.states import RigState
from stepgap.rigs.limp_rig import FrameCount, LimpRig
from stepgap.rigs.rig import Reading, Rig, RigFault, RigLayout
from stepgap.rigs.still_rig import StillRig
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.tick import LOG_UNITS
from stepgap.step import Array

LOOK_EVERY = 0.05
"""Time between two looks whether there are enough ticks [s]."""


@dataclass(frozen=True)
class Ticks:
    """Ticks of a rig, from the first one on.

    Attributes:
        rows: A tick a row, fields as in `LOG_UNITS`; shape (k, fields), k at least 1.
        refused: What of its requests the kernel refused.
        fault: Why there are not as many as were asked for.
    """

    rows: Array
    refused: str
    fault: str

    def column(self, name: str) -> Array:
        """A field of all ticks; shape (k,)."""
        return self.rows[:, list(LOG_UNITS).index(name)]


def ticks_of(setup: RealtimeSetup, count: int) -> Ticks:
    """Runs a rig for a number of ticks; nobody asks it to hop.

    Raises:
        RigFault: There was not one tick.
    """
    kept, refused = _Memory(), ""
    session = Session(setup, kept)
    try:
        with terminated_as_interrupted():
            while kept.count < count and not session.over():
                sleep(LOOK_EVERY)
                if session.board.state in (RigState.CALIBRATE, RigState.READY):
                    refused = refused or session.words()
        fault = ended(session)
    finally:
        session.close()
    if not kept.count:
        raise RigFault(fault)
    return Ticks(np.concatenate(kept.blocks)[:count], refused, fault)


def ended(session: Session) -> str:
    """Why a session has ended; empty while it has not."""
    return (session.words() or "the real-time process ended") if session.over() else ""


class _Memory:
    """Keeps ticks in memory."""

    def __init__(self) -> None:
        self.blocks: list[Array] = []
        self.count = 0

    def append(self, rows: Array) -> None:
        self.blocks.append(rows)
        self.count += len(rows)

    def flush(self) -> None:
        pass

    def close(self) -> None:
        pass


def limp_setup(make_rig: Callable[[], Rig], robot: RobotParameters, gains: Gains, frames: FrameCount) -> RealtimeSetup:
    """A robot that stays limp whatever is asked.

    Args:
        make_rig: Makes its rig; it must be possible to pickle it.
        robot: The robot it is taken to be.
        gains: Of the law whose torques are computed, and not written.
        frames: Counts those that are lost.
    """
    return RealtimeSetup(partial(_limp_robot, make_rig, robot, frames), HopperControl(robot, gains, CommandBounds()))


def still_setup(tick: float) -> RealtimeSetup:
    """No robot and no bus, but all else of a tick [s]: the same sensor values always."""
    return RealtimeSetup(partial(_still_robot, tick), HopperControl(RobotParameters(), Gains(), CommandBounds()))


def _limp_robot(make_rig: Callable[[], Rig], robot: RobotParameters, frames: FrameCount) -> LimpRig:
    return LimpRig(make_rig(), SafetyLimits.of(robot), frames)


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
