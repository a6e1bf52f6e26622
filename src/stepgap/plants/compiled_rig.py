"""A simulated rig that runs many ticks of its robot's control at once, in compiled code."""

from abc import abstractmethod
from collections.abc import Sequence
from typing import NamedTuple

from stepgap.plants.tick_control import Order, TickControl
from stepgap.rigs.rig import Rig, Torques
from stepgap.step import Array

Rows = Array | Sequence[Sequence[float]]
"""Rows of the tick log, one per tick; fields as in `TickControl.units`; shape (k, fields)."""


class TickRun(NamedTuple):
    """Ticks that were run one after the other.

    Attributes:
        rows: Log rows of the ticks; may be empty if nobody asked for them.
        time: When the next tick begins [s].
        applied: Torques that were applied in the last tick [N·m]; None if a fault prevented it.
        flags: Sum of the `TickFlag`s of the last tick.
        fault: Message of the fault that ended the run; empty if there was none.
    """

    rows: Rows
    time: float
    applied: Torques | None
    flags: int
    fault: str


class CompiledRig(Rig):
    """A rig whose time can stand still, and which calls the control of its robot without returning to Python.

    A subclass that changes `read` or `write` must change `run`, too; to observe or change single ticks, wrap the rig
    in a `WrappedRig`.
    """

    @abstractmethod
    def run(self, control: TickControl, time: float, order: Order, applied: Torques, most: int) -> TickRun:
        """Runs ticks until a step ends or fails, to the last bit as `read`, `TickControl.tick` and `write` do.

        Args:
            control: The control of the robot, made for this rig.
            time: When the first tick begins, since the start [s].
            order: What is asked of the robot in all of them.
            applied: Torques that were applied in the tick before [N·m].
            most: Largest number of ticks. Fewer may be run; at least one, unless there is a fault.
        """
