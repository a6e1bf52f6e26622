"""The interface of a device behind a slave controller."""

from abc import ABC, abstractmethod

from stepgap.hardware.ethercat.emulator.dictionary import Dictionary
from stepgap.hardware.ethercat.emulator.sensor_error import SensorError
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.rigs.rig import Reading


class EmulatedDevice(ABC):
    """A device behind a slave controller: a drive or a terminal.

    Args:
        name: Its name in this ring.
        identity: Its identity.
        dictionary: Its objects; without one it has neither mailbox nor process data.
    """

    def __init__(self, name: str, identity: Identity, dictionary: Dictionary | None = None):
        self.name, self.identity, self.dictionary = name, identity, dictionary
        self.messages: list[bytes] = []
        """Mailbox messages to be sent: emergencies."""
        self.error = SensorError()
        """Error of its sensor value."""
        self.error_bits = 0
        """Bits of the status word of a terminal that report an error."""

    @abstractmethod
    def update(self, operational: bool) -> None:
        """Acts on the outputs in the dictionary, once per tick; they are valid only if `operational`."""

    @abstractmethod
    def sense(self, reading: Reading) -> None:
        """Writes the machine's sensor values to the dictionary, once per tick."""

    @abstractmethod
    def power_on(self) -> None:
        """Resets the device, as after a loss of power."""
