"""Error of the sensor value of an emulated device, as scripted faults cause it."""

import numpy as np

from stepgap.hardware.ethercat.emulator.faults import FrozenSensor, NoisySensor, SensorFault, ShiftedSensor


class SensorError:
    """Error of a value, none at first; faults add up."""

    def __init__(self) -> None:
        self._frozen, self._shift, self._deviation, self._last = False, 0, 0.0, 0
        self._rng = np.random.default_rng(0)
        self.true_velocity = False
        """Whether the velocity of a drive remains true."""

    def begin(self, fault: SensorFault) -> None:
        """Begins a fault of the value; one of the status word changes nothing here."""
        if isinstance(fault, FrozenSensor):
            self._frozen, self.true_velocity = True, not fault.with_velocity
        elif isinstance(fault, ShiftedSensor):
            self._shift += fault.counts
        elif isinstance(fault, NoisySensor):
            self._deviation = fault.deviation

    def shown(self, counts: int) -> int:
        """Value that the device reports for a true one [counts]."""
        if not self._frozen:
            noise = round(self._rng.normal(0.0, self._deviation)) if self._deviation else 0
            self._last = counts + self._shift + noise
        return self._last
