"""Whether controllers follow their commands: the torque that they report, and faults that only limit it."""

from collections.abc import Iterable, Sequence

from stepgap.hardware.moteus.joint import JointState
from stepgap.hardware.moteus.moteus_settings import Controller
from stepgap.hardware.torque_watch import TorqueWatch
from stepgap.rigs.rig import Torques

LIMITING = range(96, 104)
"""Fault codes of a controller that works, but at a limit."""

MOST_LIMITED = 20
"""Number of readings in a row at a limit, after which the robot shall land."""

TORQUE_READINGS = 5
"""Number of readings over which delay and lag of a torque extend."""


class CommandedTorques:
    """Compares reported torques with the commands, and counts readings at a limit.

    Args:
        motors: The controllers with motors.
    """

    def __init__(self, motors: Sequence[Controller]):
        self._motors = motors
        self._watches = [TorqueWatch(motor.torque_tolerance, TORQUE_READINGS) for motor in motors]
        self._limited = dict[int, int]()

    def restart(self) -> None:
        """Forgets commands and readings."""
        self._limited.clear()
        for watch in self._watches:
            watch.restart()

    def command(self, torques: Torques) -> None:
        """Adds the torques that were sent last [N·m]."""
        for watch, torque in zip(self._watches, torques, strict=True):
            watch.command(torque)

    def excess(self, joints: Iterable[JointState]) -> str:
        """Takes a reading; returns why torque must go off, or an empty text."""
        for motor, watch, joint in zip(self._motors, self._watches, joints, strict=True):
            if watch.reading(joint.tau):
                return f"controller {motor.id}: its torque is {joint.tau:.1f} N·m, commanded were {watch.commanded} N·m"
        return ""

    def note_fault(self, number: int, code: int) -> None:
        """Takes the fault code of a controller in a reading; 0 for none."""
        self._limited[number] = self._limited.get(number, 0) + 1 if code in LIMITING else 0

    @property
    def warning(self) -> str:
        """The controller that has been at a limit for `MOST_LIMITED` readings in a row; empty without one."""
        found = [number for number, count in self._limited.items() if count >= MOST_LIMITED]
        return f"controller {found[0]} is at one of its limits (fault 96 to 103)" if found else ""
