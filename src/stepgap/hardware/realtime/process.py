"""The real-time process: it alone accesses the rig, and it lands the robot if the learning process has ended."""

import os
import signal
from collections.abc import Callable
from dataclasses import dataclass

from stepgap.base.signals import ENDING, PAUSING, handled
from stepgap.hardware.realtime.board import Board
from stepgap.hardware.realtime.loop import LOOP_MEANING, LOOP_UNITS, ControlLoop, LoopSettings
from stepgap.hardware.realtime.pace import Pace, WallClock, ask_for_realtime
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.log_description import FieldMeaning, LogDescription
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.tick_ring import TickRing, free_memory
from stepgap.rigs.rig import Rig, RigFault


@dataclass(frozen=True)
class RealtimeSetup:
    """Setup of the process; it must be possible to pickle it.

    Attributes:
        make_rig: Creates the rig, in that process.
        robot_control: Control of its robot.
        loop: Durations and limits of the loop.
        make_pace: Creates the `Pace` that waits for the ticks.
    """

    make_rig: Callable[[], Rig]
    robot_control: RobotControl
    loop: LoopSettings = LoopSettings()
    make_pace: Callable[[], Pace] = WallClock

    @property
    def units(self) -> dict[str, str]:
        """Fields of a row of the tick log, with their units."""
        return {**self.robot_control.units, **self.make_rig().diagnostic_units, **LOOP_UNITS}

    def described(self, settings: str = "") -> LogDescription:
        """Description of a log that is opened now, with the text of the file that describes the rig."""
        rig = self.make_rig()
        of_rig = FieldMeaning(names=rig.diagnostic_names, ranges=rig.diagnostic_ranges)
        return LogDescription.here(settings, self.robot_control.meaning(rig).joined(of_rig).joined(LOOP_MEANING))


def run_realtime(setup: RealtimeSetup, board_name: str, ring_name: str, parent: int) -> None:
    """Connects the rig and runs ticks on the wall clock until it is off; messages are on the board.

    Args:
        parent: Id of the process that started this one, which is its parent as long as it is alive.
    """
    board = Board.attach(board_name)
    ring = TickRing.attach(ring_name)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both processes; the other one requests the landing
    try:
        board.state = RigState.CONNECT
        rig = setup.make_rig()
        control = setup.robot_control.control(rig)
        control.resume(board.evidence)
        board.message = "; ".join(ask_for_realtime())  # before the bus is up: its watchdog would expire meanwhile
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
            with handled(lambda *_: loop.request_stop(), (*ENDING, *PAUSING)):
                loop.run(setup.make_pace())
    except Exception as error:
        # every error must reach the waiting process; the rig is already off
        board.message = str(error) if isinstance(error, RigFault | ValueError) else f"{type(error).__name__}: {error}"
        board.state = RigState.FAULT
    finally:
        ring.close()
        board.close()
        if os.getppid() != parent:
            free_memory(board_name)
            free_memory(ring_name)
