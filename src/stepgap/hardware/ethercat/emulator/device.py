"""The interface of a device behind a slave controller, and the error of its sensor value by scripted faults."""

import numpy as np

from stepgap.hardware.ethercat.emulator.dictionary import Dictionary
from stepgap.hardware.ethercat.emulator.faults import Fault
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.rigs.rig import Reading


class SensorError:
    """Error of a value, none at first; faults add up."""

    def __init__(self) -> None:
        self._frozen = False
        self._shift = 0
        self._deviation = 0.0
        self._last = 0
        self._rng = np.random.default_rng(0)
        self.true_velocity = False
        """Whether the velocity of a drive remains true."""

    def begin(self, fault: Fault) -> None:
        """Begins a fault of the value; one of the status word changes nothing here."""
        match fault.kind:
            case "frozen":
                self._frozen = True
                self.true_velocity = not fault["with_velocity"]
            case "shifted":
                self._shift += fault["counts"]
            case "noisy":
                self._deviation = fault["deviation"]

    def shown(self, counts: int) -> int:
        """Value that the device reports for a true one [counts]."""
        if not self._frozen:
            noise = round(self._rng.normal(0.0, self._deviation)) if self._deviation else 0
            self._last = counts + self._shift + noise
        return self._last


class EmulatedDevice:
    """A device behind a slave controller: a drive or a terminal. This one, as a coupler, neither acts nor senses.

    Args:
        name: Its name in this ring.
        dictionary: Its objects; without one it has neither mailbox nor process data.
    """

    def __init__(self, name: str, identity: Identity, dictionary: Dictionary | None = None):
        self.name = name
        self.identity = identity
        self.dictionary = dictionary
        self.messages: list[bytes] = []
        """Mailbox messages to be sent: emergencies."""
        self.error = SensorError()
        """Error of its sensor value."""
        self.error_bits = 0
        """Bits of the status word of a terminal that report an error."""

    def begin_sensor_fault(self, fault: Fault) -> None:
        """Begins one of `SENSOR_FAULTS`."""
        self.error.begin(fault)
        if fault.kind == "reported error":
            self.error_bits |= fault["bits"]

    def update(self, operational: bool) -> None:
        """Acts on the outputs in the dictionary, once per tick; they are valid only if `operational`."""

    def sense(self, reading: Reading) -> None:
        """Writes the machine's sensor values to the dictionary, once per tick."""

    def power_on(self) -> None:
        """Resets the device, as after a loss of power."""
