"""What rigs on any bus share: the computer's clock, times of the bus, the latched fault, the watch on a torque."""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
from time import perf_counter, sleep
from typing import Any

from stepgap.base.ranges import require
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import HEALTHY, LOST, Health, Reading, Rig, RigFault, SensorModel, Torques

MOST_WRONG = 3  # Number of readings in a row with a wrong torque, after which the drive is at fault

TORQUE_SHARE = 0.15
"""Part of the largest command by which a torque may differ, in addition to the tolerance: the accuracy of a drive."""

LOST_SHARE = 0.3  # Part of the ticks without an answer from which a device counts as absent
LOST_OVER = 50.0  # Number of ticks over which this part is a mean


class Losses:
    """Counts ticks without an answer: too many in a row, or too many of the last ones, are a fault.

    A device that answers every third time never misses many ticks in a row, but the robot is controlled by old readings
    most of the time.

    Args:
        most: Largest number of such ticks in a row.
    """

    def __init__(self, most: int):
        self._most = most
        self._share = 0.0
        self.in_a_row = 0

    def restart(self) -> None:
        """Forgets all ticks."""
        self._share = 0.0
        self.in_a_row = 0

    def received(self) -> None:
        """Counts a tick with its answers."""
        self.in_a_row = 0
        self._share -= self._share / LOST_OVER

    def missed(self) -> str:
        """Counts a tick without; returns how many there were if that is a fault, else an empty text."""
        self.in_a_row += 1
        self._share += (1.0 - self._share) / LOST_OVER
        if self.in_a_row > self._most:
            return f"{self.in_a_row} ticks in a row"
        return f"{self._share:.0%} of the last ticks" if self._share > LOST_SHARE else ""


class TorqueWatch:
    """Compares the torque of a drive with the commands of the last moments.

    A drive follows its commands after a delay and with a lag, so its torque lies between the least and the largest
    command of that time. A drive that runs away, has the wrong sign, gives nothing or keeps its torque leaves this
    range as soon as the commands do.

    Args:
        tolerance: Distance from that range that is allowed, in the unit of the commands.
        readings: Number of readings over which delay and lag extend.
    """

    def __init__(self, tolerance: float, readings: int):
        self._tolerance = tolerance
        self._sent = deque[float](maxlen=max(2, readings))
        self._wrong = 0
        self.actual = 0.0

    def restart(self) -> None:
        """Forgets all commands, as before torque is enabled."""
        self._sent.clear()
        self._wrong = 0

    def command(self, torque: float) -> None:
        """Adds the command that was sent last; before it, there was no torque."""
        if not self._sent:
            self._sent.append(0.0)
        self._sent.append(torque)

    @property
    def changed(self) -> bool:
        """Whether the commands of that time differ by more than the tolerance."""
        return bool(self._sent) and max(self._sent) - min(self._sent) > self._tolerance

    def reading(self, actual: float) -> bool:
        """Takes a reading; returns whether the torque has been wrong for `MOST_WRONG` readings in a row."""
        self.actual = actual
        if not self._sent:
            return False
        least = min(self._sent)
        most = max(self._sent)
        allowed = self._tolerance + TORQUE_SHARE * max(-least, most)
        self._wrong = self._wrong + 1 if not least - allowed <= actual <= most + allowed else 0
        return self._wrong >= MOST_WRONG

    @property
    def commanded(self) -> str:
        """The commands of that time, for messages."""
        least = min(self._sent)
        most = max(self._sent)
        return f"{least:.4g}" if least == most else f"{least:.4g} to {most:.4g}"


@dataclass(frozen=True)
class HostTime:
    """The computer's clock.

    Attributes:
        now: Returns the time [s].
        pause: Waits for a duration [s].
    """

    now: Callable[[], float] = perf_counter
    pause: Callable[[float], None] = sleep


COMPUTER = HostTime()  # The clock of this computer


class BusTiming(ABC):
    """Times of a bus and its devices; the settings of each bus have these keys.

    Attributes:
        tick: Time between two ticks of control [s].
        reply_timeout: Timeout of a reply [s].
        watchdog: Time without a command after which motors switch torque off [s].
    """

    tick: float
    reply_timeout: float
    watchdog: float

    @property
    @abstractmethod
    def devices(self) -> Mapping[str, Any]:
        """Motors and sensors by the name of their table, in the order of a reading."""

    @property
    @abstractmethod
    def budgets(self) -> RigLimits:
        """Limits of consecutive bad ticks."""

    def reading(self, values: Sequence[float]) -> Reading:
        """Makes a reading from the values of all devices, in their order."""
        return tuple(values)

    def check_times(self) -> None:
        """Raises ValueError where a time does not fit the others."""
        watchdog = self.watchdog
        require(1e-4 <= self.tick <= 0.01, "tick", self.tick, "lie between 0.0001 and 0.01")
        require(2 * self.tick <= watchdog <= 0.5, "watchdog", watchdog, "be at least two ticks, at most 0.5")
        rule = f"be positive and less than watchdog = {watchdog}"
        require(0 < self.reply_timeout < watchdog, "reply_timeout", self.reply_timeout, rule)


class BusRig(Rig):
    """A rig on a bus, whose fault is latched for the life of the object: to continue, a person must create a new one.

    Args:
        settings: The robot's bus, with its limit of lost frames.
        sensor_model: Timing of the sensors and conversion of their counts.
    """

    def __init__(self, settings: BusTiming, sensor_model: SensorModel):
        self._budgets = settings.budgets
        self._sensor_model = sensor_model
        self._fault = ""
        self._losses = Losses(settings.budgets.lost_frames)

    @property
    def sensor_model(self) -> SensorModel:
        """Timing of the sensors and conversion of their counts; zeros and signs are already applied."""
        return self._sensor_model

    @property
    def limits(self) -> RigLimits:
        """Limits from the settings."""
        return self._budgets

    @property
    def health(self) -> Health:
        """Whether the last answers were lost, so that the reading is an older one."""
        return LOST if self._losses.in_a_row else HEALTHY

    @abstractmethod
    def _torque_off(self) -> None:
        """Lets no motor have torque any more."""

    def _trip(self, message: str) -> RigFault:
        """Switches torque off and latches the fault; returns it to be raised."""
        self._fault = message
        self._torque_off()
        return RigFault(message)

    def _require_no_fault(self) -> None:
        if self._fault:
            raise RigFault(f"the rig had a fault: {self._fault}; remove its cause, then start again")

    def _require_finite(self, torques: Torques) -> None:
        if not all(map(isfinite, torques)):
            raise self._trip(f"torques must be finite, not {', '.join(map(str, torques))}")
