"""Coupler, encoder terminal and analog input terminal, like Beckhoff's EK1100, EL5151 and EL3101."""

from collections.abc import Callable

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.dictionary import Dictionary, ObjectEntry
from stepgap.hardware.ethercat.emulator.sii import Identity
from stepgap.hardware.ethercat.pdo import Entry, Pdo
from stepgap.rigs.rig import Reading

BECKHOFF = 0x00000002
COUPLER_IDENTITY = Identity("EK1100", BECKHOFF, 0x044C2C52, 0x00110000)
ENCODER_IDENTITY = Identity("EL5151", BECKHOFF, 0x141F3052, 0x00110000)
ANALOG_IDENTITY = Identity("EL3101", BECKHOFF, 0x0C1D3052, 0x00110000)

# Objects and subindices of a terminal's first channel (ETG.5001).
INPUTS = 0x6000
OUTPUTS = 0x7000
VALUE = 0x11
LATCH = 0x12

STATUS_BITS = range(1, 17)
"""Subindices of the bits of a terminal's status word; 0x0F is *TxPDO State*: the data are not valid."""

STATUS = tuple(Entry(INPUTS, subindex, 1) for subindex in STATUS_BITS)  # The status word in a PDO


class StatusWord:
    """Status word of a terminal, an object for each bit."""

    def __init__(self) -> None:
        self.entries = {(INPUTS, subindex): ObjectEntry(0, 1) for subindex in STATUS_BITS}

    def set(self, bits: int) -> None:
        """Sets all bits."""
        for subindex in STATUS_BITS:
            self.entries[INPUTS, subindex].value = bits >> (subindex - 1) & 1


class EncoderTerminal(EmulatedDevice):
    """An incremental encoder's counter, 32 bits, which wraps; latching and setting it are not emulated.

    Args:
        name: Its name in the ring.
        counts: Selects the encoder's counts from a reading.
    """

    def __init__(self, name: str, counts: Callable[[Reading], float]):
        self._counts = counts
        super().__init__(name, ENCODER_IDENTITY)
        self.power_on()

    def power_on(self) -> None:
        """Resets the PDOs; the counter follows the machine, as if the encoder were absolute."""
        self._counter = ObjectEntry(0, 32)
        self._status = StatusWord()
        objects = {
            **self._status.entries,
            (INPUTS, VALUE): self._counter,
            (INPUTS, LATCH): ObjectEntry(0, 32),
            (OUTPUTS, VALUE): ObjectEntry(0, 32, writable=True),
        }
        output = Pdo(0x1600, (Entry(0, 0, 16), Entry(OUTPUTS, VALUE, 32)))
        input_ = Pdo(0x1A00, (*STATUS, Entry(INPUTS, VALUE, 32), Entry(INPUTS, LATCH, 32)))
        self.dictionary = Dictionary(self.identity, objects, (output,), (input_,), (0x1600,), (0x1A00,))

    def sense(self, reading: Reading) -> None:
        """Updates the counter, which wraps at 2³²."""
        self._counter.value = self.error.shown(round(self._counts(reading))) & 0xFFFFFFFF
        self._status.set(self.error_bits)


class AnalogInput(EmulatedDevice):
    """An analog input of 16 bits, saturating.

    Args:
        name: Its name in the ring.
        value: Selects the value from a reading.
        resolution: Value of one count.
    """

    def __init__(self, name: str, value: Callable[[Reading], float], resolution: float):
        self._value = value
        self._resolution = resolution
        super().__init__(name, ANALOG_IDENTITY)
        self.power_on()

    def power_on(self) -> None:
        """Resets counts and PDOs."""
        self._counts = ObjectEntry(0, 16, True)
        self._status = StatusWord()
        objects = {**self._status.entries, (INPUTS, VALUE): self._counts}
        inputs = (Pdo(0x1A00, (*STATUS, Entry(INPUTS, VALUE, 16))),)
        self.dictionary = Dictionary(self.identity, objects, (), inputs, (), (0x1A00,))

    def sense(self, reading: Reading) -> None:
        """Updates the value in counts."""
        shown = self.error.shown(round(self._value(reading) / self._resolution))
        self._counts.value = min(max(shown, -32768), 32767)
        self._status.set(self.error_bits)
