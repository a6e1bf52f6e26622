"""The seam to whatever moves: sensor counts in, torques out."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Self

from stepgap.base.errors import StepGapError
from stepgap.rigs.limits import RigLimits

Reading = tuple[float, ...]
"""What the sensors say at one tick: counts and forces, in an order that the robot defines."""

Torques = tuple[float, ...]
"""One torque per motor [N·m], in an order that the robot defines."""


@dataclass(frozen=True, kw_only=True)
class SensorModel:
    """When a rig's sensors are read; each robot adds how to read their counts.

    Attributes:
        tick: Time between two reads [s].
        frames_per_tick: Frames of a bus in a tick; those between two ticks repeat the torques.
        sampled_at_write: A reading is of the moment of the last write, whose frame brings it back, not of the read.
    """

    tick: float
    frames_per_tick: int = 1
    sampled_at_write: bool = False


class Health(NamedTuple):
    """How a tick itself went.

    Attributes:
        frame_lost: The bus gave no valid frame.
        stale: The reading is that of the tick before.
        late: Whole ticks by which this one began past its due time.
        emergency_stop: Somebody asked for the software stop.
    """

    frame_lost: bool = False
    stale: bool = False
    late: int = 0
    emergency_stop: bool = False


HEALTHY = Health()
"""A tick without complaint."""

LOST = Health(frame_lost=True, stale=True)
"""A tick whose frame was lost, so that the reading is that of the tick before."""


class RigFault(StepGapError):
    """The rig stopped: torque is off and stays off."""


class Rig(ABC):
    """Torque-controlled motors and the sensors of a robot.

    A tick is `read` followed by `write`. Used as a context manager it connects and closes.
    """

    @property
    @abstractmethod
    def sensor_model(self) -> SensorModel:
        """How to read the counts."""

    @property
    def limits(self) -> RigLimits | None:
        """What its motors and joints may do; None where nothing but the robot's torque limit is known."""
        return None

    @abstractmethod
    def connect(self) -> None:
        """Makes the rig ready to tick, motors limp."""

    @abstractmethod
    def read(self) -> Reading:
        """Sensor values at the present tick.

        Raises:
            RigFault: No valid values can be had.
        """

    @property
    def health(self) -> Health:
        """How the last `read` went: whoever may repeat a reading says so here; all else is a `RigFault`."""
        return HEALTHY

    @abstractmethod
    def write(self, torques: Torques) -> Torques:
        """Commands the motor torques for one tick [N·m] and returns those really applied.

        Raises:
            RigFault: A torque is not finite, or the drives refuse it.
        """

    @abstractmethod
    def close(self) -> None:
        """Torque off, resources released; may be called twice."""

    def __enter__(self) -> Self:
        self.connect()
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()
