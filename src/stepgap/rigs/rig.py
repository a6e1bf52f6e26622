"""The interface of a rig: sensor counts in, torques out."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Self

from stepgap.base.errors import StepGapError
from stepgap.rigs.limits import RigLimits

Reading = tuple[float, ...]
"""Sensor values of one tick: counts and forces, in an order that the robot defines."""

Torques = tuple[float, ...]
"""One torque per motor [N·m], in an order that the robot defines."""


CLOCK_OFFSET, CLOCK_OUTSIDE = "clock_offset", "clock_outside"
"""Diagnostics of a rig whose devices have a clock of their own.

Of the messages of the last tick, the largest distance from their times on that clock, late ones positive [s]; and the
largest number of them in a row, with those before, outside of the window of `ClockLimits`.
"""

CLOCK_DIFFERENCE = "clock_difference"
"""End of the names of diagnostics that are the last known difference of a device's clock from that clock [s]."""


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """Timing of a rig's sensors; each robot adds the conversion of their counts.

    Attributes:
        tick: Time between two reads [s].
        frames_per_tick: Frames of a bus per tick; those between two ticks repeat the torques.
        sampled_at_write: A reading was sampled at the last write, whose frame returned it, not at the read.
    """

    tick: float
    frames_per_tick: int = 1
    sampled_at_write: bool = False


class Health(NamedTuple):
    """Errors of communication and timing in a tick.

    Attributes:
        frame_lost: The bus returned no valid frame.
        stale: The reading is that of the tick before.
        late: Number of complete ticks by which this one began after its due time.
        emergency_stop: The software stop was requested.
    """

    frame_lost: bool = False
    stale: bool = False
    late: int = 0
    emergency_stop: bool = False


HEALTHY = Health()  # A tick without errors

LOST = Health(frame_lost=True, stale=True)
"""A tick whose frame was lost, so that the reading is that of the tick before."""


@dataclass(frozen=True)
class ClockLimits:
    """What a check demands of a rig whose devices have a clock of their own.

    Attributes:
        usual: Largest distance of 99.9 % of the messages from their times on that clock [s].
        window: Distance within which a message is in time [s].
        outside: Largest number of consecutive messages outside of this window.
        difference: Largest difference of a device's clock from that clock [s].
    """

    usual: float
    window: float
    outside: int
    difference: float


@dataclass(frozen=True)
class WatchdogTimes:
    """How long after the last message of the computer motors kept their torque.

    Attributes:
        setting: Time that the settings demand [s].
        measured: Time by the name of the motor, or of its drive [s]; it includes the time of the measurement itself.
    """

    setting: float
    measured: Mapping[str, float]


@dataclass(frozen=True)
class Finding:
    """What a document about a device says against the settings of a rig.

    Attributes:
        text: One sentence.
        is_error: Settings and document contradict each other; otherwise it is only doubtful whether they agree.
    """

    text: str
    is_error: bool = True


class RigFault(StepGapError):
    """Error of a rig that has stopped: torque is off and remains off."""


class MissingObject(RigFault):
    """Error of a device that lacks an object."""


class DoubtfulSensor(RigFault):
    """Fault of a rig that has stopped because of a sensor whose values are doubtful."""


class Rig(ABC):
    """Torque-controlled motors and the sensors of a robot.

    A tick is `read` followed by `write`. Used as a context manager it connects and closes.
    """

    @property
    @abstractmethod
    def sensor_model(self) -> SensorModel:
        """Timing of the sensors and conversion of their counts."""

    @property
    def limits(self) -> RigLimits | None:
        """Limits of its motors, joints and ticks; None where only the robot's torque limit is known."""
        return None

    @property
    def clock_limits(self) -> ClockLimits | None:
        """Limits of the clock of its devices; None if they have none of their own."""
        return None

    @property
    def diagnostic_units(self) -> Mapping[str, str]:
        """Names and units of the `diagnostics`; known before the rig is connected."""
        return {}

    @property
    def diagnostics(self) -> tuple[float, ...]:
        """What the drives reported with the last reading, for logs only, as `diagnostic_units` describes it."""
        return ()

    @property
    def diagnostic_ranges(self) -> Mapping[str, tuple[float, float]]:
        """Least and largest allowed value of those diagnostics that the rig itself judges; infinite without a limit."""
        return {}

    @property
    def diagnostic_names(self) -> Mapping[str, Mapping[int, str]]:
        """Names of the numbers of those diagnostics that are enumerated."""
        return {}

    @property
    def warning(self) -> str:
        """Why a moving robot should land and a limp one get no torque, although there is no fault, as one line.

        It is empty if there is no reason.
        """
        return ""

    def clock_correction(self, slip: float = 0.0) -> float:  # noqa: ARG002
        """Time by which the next tick and all later ones shall begin later, called once before each tick [s].

        A rig whose devices have a clock of their own steers the ticks to that clock. Before the first tick it may
        return the time from now on.

        Args:
            slip: Time by which the present tick has shifted all later ones, since it was late by more than a tick [s].
        """
        return 0.0

    @property
    def remarks(self) -> tuple[str, ...]:
        """What a person should know about the connected rig, although it is no fault; one line each."""
        return ()

    def findings(self) -> tuple[Finding, ...]:
        """Compares the settings with documents of the devices, and while the rig is connected also with its devices.

        It reads files, which takes time: not between two ticks.

        Raises:
            InputError: A document cannot be read.
        """
        return ()

    @property
    def truth(self) -> tuple[float, ...]:
        """State of the robot as it truly was at the end of the last step; empty where it is unknown, as on hardware.

        A simulated rig may know it, in the order of the state that the robot measures. It is recorded for reports only:
        nothing that controls or learns may read it.
        """
        return ()

    @property
    def released(self) -> tuple[float, ...]:
        """State at which the robot, held after `connect`, is released; empty where it is unknown, or at no section.

        A stand that holds a hopper at rest in the air releases it at an apex, so that its first step is one like any
        other. A robot that a person lowers to the ground begins at no apex.
        """
        return ()

    @abstractmethod
    def connect(self) -> None:
        """Prepares the rig for the first tick, without torque."""

    @abstractmethod
    def read(self) -> Reading:
        """Reads the sensor values of the present tick.

        Raises:
            RigFault: There are no valid values.
        """

    @property
    def health(self) -> Health:
        """Health of the last `read`: a rig that repeats a reading reports it here; other errors are a `RigFault`."""
        return HEALTHY

    @abstractmethod
    def write(self, torques: Torques) -> Torques:
        """Commands the motor torques for one tick [N·m] and returns those actually applied.

        Raises:
            RigFault: A torque is not finite, or the drives refuse it.
        """

    def watchdog_times(self) -> WatchdogTimes | None:
        """Sends no more torques and measures when the motors switch torque off by themselves; close the rig then.

        Call it on a connected rig without torque. It returns None if the rig cannot measure this.

        Raises:
            RigFault: A motor would keep its torque, or the rig has failed.
        """
        return None

    @abstractmethod
    def close(self) -> None:
        """Switches torque off and releases the resources; may be called twice."""

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
