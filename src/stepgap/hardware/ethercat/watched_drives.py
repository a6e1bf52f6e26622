"""The watches of all drives of a bus, whose values have the names of the motors."""

from collections.abc import Callable, Mapping
from typing import TypeVar

from stepgap.hardware.ethercat.drive_watch import DriveWatch
from stepgap.hardware.ethercat.rig_settings import BusSettings, Motor

_T = TypeVar("_T")

NO_STO_INPUT = "no drive reports its STO input (digital_inputs, sto_bits): an open one is seen only by a drive's state"
"""Remark on a bus whose messages cannot name its STO inputs."""

TORQUE_NOT_REPORTED = "does not report its torque (0x6077), so that it cannot be compared with the commands"
"""Remark on a drive."""


class WatchedDrives:
    """Watches what the drives report beside their motion.

    Args:
        settings: The robot's bus.
        label: Gives the name of a slave for messages.
        inputs: Gives the inputs of a slave from the last good frame.
    """

    def __init__(self, settings: BusSettings, label: Callable[[int], str], inputs: Callable[[int], Mapping[str, int]]):
        self._inputs, self._watches = inputs, dict[str, tuple[int, DriveWatch]]()
        self.remarks: list[str] = []
        """What drives report without a limit, and whether none reports its STO input."""
        for table, motor in settings.devices.items():
            if isinstance(motor, Motor):
                drive, entries = settings.position(motor.slave), settings.input_entries(motor.slave)
                self._watches[table] = drive, DriveWatch(label(drive), motor, entries, settings.cycle)
                self.remarks += motor.remarks(label(drive), entries)
                self.remarks += [] if "torque" in entries else [f"{label(drive)} {TORQUE_NOT_REPORTED}"]
        self.hint = "" if any(motor.sto_bits for motor in settings.motors) else NO_STO_INPUT
        """Why messages cannot name an open STO input; empty if they can."""
        if self.hint:
            self.remarks.insert(0, self.hint)

    @property
    def units(self) -> dict[str, str]:
        """Logged values with their units."""
        return self._of_all(lambda watch: watch.units)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Limits of logged values; infinite where there is none."""
        return self._of_all(lambda watch: watch.ranges)

    @property
    def names(self) -> dict[str, Mapping[int, str]]:
        """Names of the numbers of logged values."""
        return self._of_all(lambda watch: watch.names)

    @property
    def values(self) -> tuple[float, ...]:
        """Logged values in the last reading."""
        return tuple([value for _, watch in self._watches.values() for value in watch.values])

    @property
    def warning(self) -> str:
        """Why the robot should land; empty if there is no reason."""
        return next((warning for _, watch in self._watches.values() if (warning := watch.warning)), "")

    def restart(self) -> None:
        """Forgets earlier readings."""
        for _, watch in self._watches.values():
            watch.restart()

    def command(self, number: int, units: int) -> None:
        """Adds the command that was sent to a drive last, in 1/1000 of the rated torque."""
        for drive, watch in self._watches.values():
            if drive == number:
                watch.command(units)

    def update(self) -> str:
        """Takes the inputs of a good frame; returns why torque must go off, or an empty text."""
        faults = [watch.update(self._inputs(drive)) for drive, watch in self._watches.values()]
        return "; ".join(filter(None, faults)) if any(faults) else ""

    def open_inputs(self) -> str:
        """Names the STO and enable inputs that are open in the last good frame; empty if none is."""
        found = [watch.open_inputs(self._inputs(drive)) for drive, watch in self._watches.values()]
        return "; ".join(filter(None, found))

    def describe(self, number: int) -> str:
        """Describes temperature and bus voltage of a drive in the last good frame; empty if it reports neither."""
        found = [watch.describe(self._inputs(drive)) for drive, watch in self._watches.values() if drive == number]
        return ", ".join(filter(None, found))

    def _of_all(self, values: Callable[[DriveWatch], Mapping[str, _T]]) -> dict[str, _T]:
        """Values of all watches, with the names of the motors before theirs."""
        return {
            f"{motor}_{name}": value
            for motor, (_, watch) in self._watches.items()
            for name, value in values(watch).items()
        }
