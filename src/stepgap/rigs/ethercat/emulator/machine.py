"""What the drives move: torques in, sensor values out, a tick at a time."""

from abc import ABC, abstractmethod

from stepgap.rigs.rig import Reading
from stepgap.robots.hopper.twin.twin import Twin


class Machine(ABC):
    """Two motors and what they move."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Time of a tick [s]."""

    @abstractmethod
    def start(self) -> Reading:
        """Puts it to where it starts from, held there until the first tick."""

    @abstractmethod
    def tick(self, torque_1: float, torque_2: float) -> Reading:
        """Moves on by one tick under the motors' torques [N·m] and says what the sensors read then.

        Raises:
            RigFault: It left its bounds.
        """


class TwinMachine(Machine):
    """The MuJoCo twin behind the drives.

    Args:
        twin: Its sensors must count, not be exact, since a ring carries whole counts; exact ones are rounded.
    """

    def __init__(self, twin: Twin):
        self._twin = twin

    @property
    def period(self) -> float:
        """Time of a tick [s]."""
        return self._twin.layout.tick

    def start(self) -> Reading:
        """The twin in its starting pose, held."""
        self._twin.connect()
        return self._twin.read()

    def tick(self, torque_1: float, torque_2: float) -> Reading:
        """One tick of the twin.

        Raises:
            RigFault: A motor runs away, or the motion has left what can be measured.
        """
        self._twin.write(torque_1, torque_2)
        return self._twin.read()
