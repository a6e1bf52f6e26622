"""The hopper on two moteus controllers with boom encoders and contact at their auxiliary ports (`moteus.toml`)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build, read_toml, with_table
from stepgap.rigs.moteus.moteus_rig import POSITION_COUNTS, MoteusRig
from stepgap.rigs.moteus.moteus_settings import AuxEncoder, AuxForce, CanDevice, CanSettings, Controller
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import RobotParameters, parameters_of
from stepgap.robots.hopper.sensors import HopperReading, HopperSensorModel
from stepgap.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class AuxContact(AuxForce):
    """Settings of the contact force sensor.

    Attributes:
        touchdown_force: Force above which the foot is on the ground [N] (Sec. 3.3).
        takeoff_length: Leg length at which the leg leaves the ground [m] (Sec. 3.4).
    """

    touchdown_force: float
    takeoff_length: float = inf

    def __post_init__(self) -> None:
        super().__post_init__()
        force, length = self.touchdown_force, self.takeoff_length
        require(0 <= force <= 1e6, "touchdown_force", force, "lie between 0 and 1e6")
        require(length > 0, "takeoff_length", length, "be positive")


@dataclass(frozen=True, kw_only=True)
class MoteusSettings(CanSettings):
    """Settings of the hopper's CAN bus.

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
    motor_1: Controller
    motor_2: Controller
    boom_horizontal: AuxEncoder
    boom_vertical: AuxEncoder
    contact: AuxContact
    limits: SafetyLimits

    def __post_init__(self) -> None:
        require(isfinite(self.pivot_height), "pivot_height", self.pivot_height, "be finite")
        super().__post_init__()
        gears = (self.motor_1.gear, self.motor_2.gear)
        require(gears[1] == gears[0], "motor_2.gear", gears[1], f"be that of motor 1, {gears[0]:g}")
        yaw, pitch = self.boom_horizontal, self.boom_vertical
        differs = (pitch.id, pitch.source) != (yaw.id, yaw.source)
        require(differs, "boom_vertical.source", pitch.source, "differ from the horizontal angle's")

    @property
    def devices(self) -> Mapping[str, CanDevice]:
        """Controllers, boom encoders and contact sensor in the order of a `HopperReading`."""
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
        """Sensor model for counts to which zeros and signs are already applied.

        Args:
            boom_length: Distance from pivot to hip [m].
        """
        return HopperSensorModel(
            tick=self.tick,
            boom_length=boom_length,
            pivot_height=self.pivot_height,
            motor_counts=POSITION_COUNTS * self.motor_1.gear,
            boom_counts_horizontal=self.boom_horizontal.counts_per_turn,
            boom_counts_vertical=self.boom_vertical.counts_per_turn,
            touchdown_force=self.contact.touchdown_force,
            takeoff_length=self.contact.takeoff_length,
        )


def read_moteus_settings(path: Path) -> MoteusSettings:
    """Reads the settings of a rig from a TOML file.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    return build(MoteusSettings, read_toml(path, "a rig"), lambda name: f"{path}: {with_table(name)}")


def hopper_on_moteus(settings: MoteusSettings, robot: RobotParameters) -> MoteusRig:
    """Rig of these settings, not yet connected; its sensor model uses the robot's boom length."""
    return MoteusRig(settings, settings.sensor_model(robot.boom_length))


def moteus_rig_from_file(settings: Path, robot: Robot) -> MoteusRig:
    """Rig described by a `moteus.toml`; entry point of `stepgap.rigs`.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule. Or the robot is not the hopper.
    """
    return hopper_on_moteus(read_moteus_settings(settings), parameters_of(robot))
