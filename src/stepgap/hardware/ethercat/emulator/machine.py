"""The interface of the machine that the drives move: torques in, sensor values out, tick by tick."""

from abc import ABC, abstractmethod
from collections.abc import Sequence

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Reading, Torques


class Machine(ABC):
    """Motors and what they move."""

    @property
    @abstractmethod
    def period(self) -> float:
        """Time of a tick [s]."""

    @abstractmethod
    def devices(self, settings: RingSettings) -> Sequence[EmulatedDevice]:
        """Creates its drives and sensors, in the order in which frames pass them."""

    @abstractmethod
    def start(self) -> Reading:
        """Puts the machine into its start position, where it is held until the first tick."""

    @abstractmethod
    def tick(self, torques: Torques) -> Reading:
        """Simulates one tick with the motors' torques [N·m] and returns the sensor values at its end.

        Raises:
            RigFault: The machine left its bounds.
        """
