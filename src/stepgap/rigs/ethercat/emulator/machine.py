"""What the drives move: torques in, sensor values out, a tick at a time."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from stepgap.rigs.ethercat.emulator.device import EmulatedDevice
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Reading, Torques


class Machine(ABC):
    """Motors and what they move."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Time of a tick [s]."""

    @abstractmethod
    def devices(self, settings: RingSettings) -> Sequence[EmulatedDevice]:
        """The ring of its drives and sensors, in the order in which frames pass them."""

    @abstractmethod
    def start(self) -> Reading:
        """Puts it to where it starts from, held there until the first tick."""

    @abstractmethod
    def tick(self, torques: Torques) -> Reading:
        """Moves on by one tick under the motors' torques [N·m] and says what the sensors read then.

        Raises:
            RigFault: It left its bounds.
        """
