"""The real-time process: it alone speaks to the rig, and it lands the robot when the process that learns is gone."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

from stepgap.plants.estimator import FlightFit
from stepgap.plants.hop_control import HopControl
from stepgap.plants.phases import Phase
from stepgap.plants.realtime.board import Board
from stepgap.plants.realtime.loop import ControlLoop, LoopSettings
from stepgap.plants.realtime.pace import Pace, WallClock, ask_for_realtime
from stepgap.plants.realtime.states import RigState
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.rigs.rig import Reading, Rig, RigFault
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters


@dataclass(frozen=True)
class RealtimeSetup:
    """What the process is to do; it must be possible to pickle it.

    Attributes:
        make_rig: Makes the rig, in that process.
        robot: The robot the rig is taken to be.
        gains: Joint controller.
        bounds: Range of the command.
        loop: Times and budgets.
        make_pace: Makes what waits for the ticks.
    """

    make_rig: Callable[[], Rig]
    robot: RobotParameters
    gains: Gains
    bounds: CommandBounds
    loop: LoopSettings = LoopSettings()
    make_pace: Callable[[], Pace] = WallClock

    def control(self, rig: Rig) -> HopControl:
        """The joint control of a rig, all of it compiled: a first call would take longer than a tick."""
        limits = rig.limits or SafetyLimits.of(self.robot)
        trial = HopControl(rig.layout, self.robot, self.gains, limits)
        turn = rig.layout.motor_counts / 8
        for ticks in range(25):  # a leg that stretches on the ground, through all its laws
            counts = turn * (1 - ticks / 50)
            trial.begin_tick()
            trial.sense(Reading(counts, -counts, 0, 0, 2 * rig.layout.touchdown_force + 1))
            for torque in (trial.posture_torque(), trial.landing_torque(0.5), trial.hop_torque((1.0, 1.0))):
                checked = trial.check(torque)
            trial.close_tick(torque, (0.0, 0.0), checked)
        assert trial.phase in (Phase.PUSHING, Phase.RISING)
        fit = FlightFit()
        for time in range(4):
            fit.add(time, 0.0, -float(time**2))
        fit.apex_height()
        return HopControl(rig.layout, self.robot, self.gains, limits)


def run_realtime(setup: RealtimeSetup, board_name: str, ring_name: str, parent: int) -> None:
    """Connects the rig and ticks by the wall clock until it is off; what it has to say is on the board.

    Args:
        setup: What to do.
        board_name: Of the board to attach to.
        ring_name: Of the ring that takes the ticks.
        parent: Process that started this one and, while that lives, is its parent.
    """
    board, ring = Board.attach(board_name), TickRing.attach(ring_name)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the other one asks for the landing
    try:
        board.state = RigState.CONNECT
        rig = setup.make_rig()
        control = setup.control(rig)
        board.words = "; ".join(ask_for_realtime())  # before the bus is up: its watchdog would not wait for it
        with rig:
            board.state = RigState.CALIBRATE
            loop = ControlLoop(
                rig, control, setup.bounds, board, ring.push, setup.loop, alive=lambda: os.getppid() == parent
            )
            signal.signal(signal.SIGTERM, lambda *_: loop.ask_to_stop())
            loop.run(setup.make_pace())
    except Exception as error:
        # whatever it is, the one who waits must learn of it; the rig is off by now
        board.words = str(error) if isinstance(error, RigFault | ValueError) else f"{type(error).__name__}: {error}"
        board.state = RigState.FAULT
    finally:
        ring.close()
        board.close()
