"""What sits behind a slave controller."""

from abc import ABC, abstractmethod

from stepgap.rigs.ethercat.emulator.dictionary import Dictionary
from stepgap.rigs.ethercat.emulator.sii import Identity
from stepgap.rigs.rig import Reading


class EmulatedDevice(ABC):
    """What sits behind a slave controller: a drive or a terminal.

    Args:
        name: What it is called in this ring.
        identity: Who it is.
        dictionary: Its objects; without one it has neither mailbox nor process data.
    """

    def __init__(self, name: str, identity: Identity, dictionary: Dictionary | None = None):
        self.name, self.identity, self.dictionary = name, identity, dictionary
        self.messages: list[bytes] = []
        """Mailbox messages to be sent, emergencies."""

    @abstractmethod
    def update(self, operational: bool) -> None:
        """Acts on the outputs in the dictionary, once a tick; they are valid only where `operational`."""

    @abstractmethod
    def sense(self, reading: Reading) -> None:
        """Puts what the machine's sensors say into the dictionary, once a tick."""

    @abstractmethod
    def power_on(self) -> None:
        """Begins anew, as after a loss of power."""
