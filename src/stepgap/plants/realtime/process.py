"""The real-time process: it alone speaks to the rig, and it lands the robot when the process that learns is gone."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

from stepgap.plants.realtime.board import Board
from stepgap.plants.realtime.loop import LOOP_UNITS, ControlLoop, LoopSettings
from stepgap.plants.realtime.pace import Pace, WallClock, ask_for_realtime
from stepgap.plants.realtime.states import RigState
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.tick_ring import TickRing
from stepgap.rigs.rig import Rig, RigFault


@dataclass(frozen=True)
class RealtimeSetup:
    """What the process is to do; it must be possible to pickle it.

    Attributes:
        make_rig: Makes the rig, in that process.
        robot_control: How its robot is controlled.
        loop: Times and budgets.
        make_pace: Makes what waits for the ticks.
    """

    make_rig: Callable[[], Rig]
    robot_control: RobotControl
    loop: LoopSettings = LoopSettings()
    make_pace: Callable[[], Pace] = WallClock

    @property
    def units(self) -> dict[str, str]:
        """Fields of a row of the tick log, with their units."""
        return {**self.robot_control.units, **LOOP_UNITS}


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
        control = setup.robot_control.control(rig)
        board.words = "; ".join(ask_for_realtime())  # before the bus is up: its watchdog would not wait for it
        with rig:
            board.state = RigState.CALIBRATE
            loop = ControlLoop(
                rig,
                control,
                setup.robot_control.space,
                board,
                ring.push,
                setup.loop,
                alive=lambda: os.getppid() == parent,
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
