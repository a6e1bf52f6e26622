"""Whether a real-time process makes ticks: after SIGSTOP, or in a call that never returns, it only seems alive."""

from stepgap.hardware.realtime.board import Board
from stepgap.hardware.realtime.loop import LoopSettings
from stepgap.plants.ticks.rig_state import RigState

EXIT_TIME = 5.0
"""Longest time from the last tick to the end of the process [s]."""


class TickWatch:
    """Measures how long a process has made no tick.

    The time is the sum of what the observer has waited between its looks, not that of a clock: a pause of the observer
    itself, as when the whole computer sleeps, is not a silence of the process.

    Args:
        board: Counts the ticks of the process.
        settings: Contains the longest times without a tick.
    """

    def __init__(self, board: Board, settings: LoopSettings):
        self._board, self._settings = board, settings
        self._ticks, self._silence = 0, 0.0

    def silent(self, waited: float) -> str:
        """Describes a silence that is too long; empty if it is not.

        Args:
            waited: Time since the last look [s].
        """
        ticks = self._board.ticks
        self._silence = 0.0 if ticks != self._ticks else self._silence + waited
        self._ticks = ticks
        if self._silence <= self._longest():
            return ""
        return (
            f"the real-time process made no tick for {self._silence:.1f} s and was killed; "
            "the watchdog of the drives switches torque off"
        )

    def _longest(self) -> float:
        """Longest silence in the present state [s]."""
        if not self._ticks:
            return self._settings.connect_time
        over = self._board.state in (RigState.OFF, RigState.FAULT)
        return EXIT_TIME if over else self._settings.tick_silence
