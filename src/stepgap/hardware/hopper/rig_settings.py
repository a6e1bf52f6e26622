"""The settings of a hopper's rig that are the same for every bus."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from typing import Any

from stepgap.base.ranges import require
from stepgap.rigs.rig import SensorModel
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel


@dataclass(frozen=True, kw_only=True)
class ContactThresholds:
    """When the foot is on the ground; the table of a contact force sensor has these keys besides the sensor's own.

    Attributes:
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        takeoff_length: Leg length at which the leg leaves the ground [m] (Sec. 3.4).
    """

    touchdown_force: float
    takeoff_length: float = inf

    def __post_init__(self) -> None:
        force = self.touchdown_force
        length = self.takeoff_length
        require(0 <= force <= 1e6, "touchdown_force", force, "lie between 0 and 1e6")
        require(length > 0, "takeoff_length", length, "be positive")


@dataclass(frozen=True, kw_only=True)
class HopperRigSettings(ABC):
    """Two motors, two boom encoders, a contact force and their limits; each bus declares the types of its devices.

    Attributes:
        pivot_height: Height of the boom's pivot above the ground [m].
        motor_1: Motor of the top link at α₁ + α₂.
        motor_2: Motor of the top link at α₁ − α₂.
        boom_horizontal: Yaw of the boom.
        boom_vertical: Pitch of the boom.
        contact: Ground force.
        limits: Limits of the safety function.
    """

    pivot_height: float
    motor_1: Any
    motor_2: Any
    boom_horizontal: Any
    boom_vertical: Any
    contact: Any
    limits: SafetyLimits

    def __post_init__(self) -> None:
        require(isfinite(self.pivot_height), "pivot_height", self.pivot_height, "be finite")

    @property
    @abstractmethod
    def timing(self) -> SensorModel:
        """When the bus samples its sensors."""

    @property
    @abstractmethod
    def motor_counts(self) -> float:
        """Counts of a motor's encoder per turn of its top link."""

    @property
    def devices(self) -> Mapping[str, Any]:
        """Motors, boom encoders and contact sensor in the order of a `HopperReading`."""
        names = ("motor_1", "motor_2", "boom_horizontal", "boom_vertical", "contact")
        return {name: getattr(self, name) for name in names}

    @property
    def budgets(self) -> SafetyLimits:
        """Safety limits, which include the budgets of lost frames and bad ticks."""
        return self.limits

    def reading(self, values: Sequence[float]) -> HopperReading:
        """Reading whose values have names."""
        return HopperReading(*values)

    def sensor_model(self, boom_length: float) -> HopperSensorModel:
        """Sensor model for counts to which zeros and signs are already applied, for a length from pivot to hip [m]."""
        return HopperSensorModel(
            tick=self.timing.tick,
            frames_per_tick=self.timing.frames_per_tick,
            sampled_at_write=self.timing.sampled_at_write,
            boom_length=boom_length,
            pivot_height=self.pivot_height,
            motor_counts=self.motor_counts,
            boom_counts_horizontal=self.boom_horizontal.counts_per_turn,
            boom_counts_vertical=self.boom_vertical.counts_per_turn,
            touchdown_force=self.contact.touchdown_force,
            takeoff_length=self.contact.takeoff_length,
        )
