"""The hopper's sensors: their reading at a tick, and the model that converts their counts."""

from dataclasses import dataclass
from typing import NamedTuple

from stepgap.rigs.rig import RigFault, SensorModel


@dataclass(frozen=True, kw_only=True)
class HopperSensorModel(SensorModel):
    """Sensor model of the hopper: how counts become angles and lengths; constant while its rig is connected.

    Motor 1 turns the top link at α₁ + α₂, motor 2 the one at α₁ − α₂; both angles are measured from
    the downward vertical, forward positive. The horizontal boom angle times `boom_length` is the
    hip's distance travelled; the vertical boom angle ϑ gives its height
    `pivot_height + boom_length · sin ϑ`. An angle is `2π · (counts − zero) / counts_per_turn`.

    Attributes:
        boom_length: Distance from pivot to hip [m].
        pivot_height: Height of the boom's pivot above the ground [m].
        motor_counts: Counts per turn of a motor encoder.
        boom_counts_horizontal: Counts per turn of the yaw encoder.
        boom_counts_vertical: Counts per turn of the pitch encoder.
        touchdown_force: Contact force above which the foot is taken to be on the ground [N] (Sec. 3.3).
        takeoff_length: Leg length at which the leg is taken to leave the ground [m] (Sec. 3.4);
            infinite where only the contact force decides.
    """

    boom_length: float
    pivot_height: float
    motor_counts: float
    boom_counts_horizontal: float
    boom_counts_vertical: float
    touchdown_force: float
    takeoff_length: float


class HopperReading(NamedTuple):
    """Sensor values of the hopper at one tick: a `Reading` whose numbers have names.

    Attributes:
        motor_1: Encoder counts of motor 1 (integers, unless the rig senses exactly).
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


def hopper_sensors(model: SensorModel) -> HopperSensorModel:
    """The sensor model of a rig, if it is that of a hopper.

    Raises:
        RigFault: The rig is that of another robot.
    """
    if not isinstance(model, HopperSensorModel):
        raise RigFault(f"the rig's sensor model must be a HopperSensorModel, not {type(model).__name__}")
    return model
