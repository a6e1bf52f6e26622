"""The seam to whatever moves: sensor counts in, torques out."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import NamedTuple, Self

from stepgap.base.errors import StepGapError
from stepgap.robots.hopper.limits import SafetyLimits


@dataclass(frozen=True)
class RigLayout:
    """How to read a rig's counts; fixed while it is connected.

    Motor 1 turns the top link at α₁ + α₂, motor 2 the one at α₁ − α₂; both angles are measured from
    the downward vertical, forward positive. The horizontal boom angle times `boom_length` is the
    hip's distance travelled; the vertical boom angle ϑ gives its height
    `pivot_height + boom_length · sin ϑ`. An angle is `2π · (counts − zero) / counts_per_turn`.

    Attributes:
        tick: Time between two reads [s].
        boom_length: From pivot to hip [m].
        pivot_height: Height of the boom's pivot above the ground [m].
        motor_counts: Counts a turn of a motor encoder.
        boom_counts_horizontal: Counts a turn of the yaw encoder.
        boom_counts_vertical: Counts a turn of the pitch encoder.
        touchdown_force: Contact force above which the foot is taken to be on the ground [N] (Sec. 3.3).
        takeoff_length: Leg length at which the leg is taken to leave the ground [m] (Sec. 3.4);
            infinite where only the contact force tells.
        frames_per_tick: Frames of a bus in a tick; those between two ticks repeat the torques.
        sampled_at_write: A reading is of the moment of the last write, whose frame brings it back, not of the read.
    """

    tick: float
    boom_length: float
    pivot_height: float
    motor_counts: float
    boom_counts_horizontal: float
    boom_counts_vertical: float
    touchdown_force: float
    takeoff_length: float
    frames_per_tick: int = 1
    sampled_at_write: bool = False


class Reading(NamedTuple):
    """What the sensors say at one tick.

    Attributes:
        motor_1: Encoder counts of motor 1 (whole numbers, unless the rig senses exactly).
        motor_2: Encoder counts of motor 2.
        boom_horizontal: Counts of the yaw encoder.
        boom_vertical: Counts of the pitch encoder.
        contact_force: Vertical ground force on the foot [N].
    """

    motor_1: float
    motor_2: float
    boom_horizontal: float
    boom_vertical: float
    contact_force: float


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
    """Two torque-controlled motors, their encoders, two boom encoders and a contact force.

    A tick is `read` followed by `write`. Used as a context manager it connects and closes.
    """

    @property
    @abstractmethod
    def layout(self) -> RigLayout:
        """How to read the counts."""

    @property
    def limits(self) -> SafetyLimits | None:
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
    def write(self, torque_1: float, torque_2: float) -> tuple[float, float]:
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
