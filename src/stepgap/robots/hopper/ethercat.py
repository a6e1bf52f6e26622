"""The hopper on an EtherCAT bus: two drives, two boom encoders and a contact force, as `rig.toml` describes them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf, isfinite
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build, read_toml, with_table
from stepgap.rigs.ethercat.distributed_clocks import COMPUTER
from stepgap.rigs.ethercat.ethercat_rig import EthercatRig
from stepgap.rigs.ethercat.rig_settings import BusSettings, Encoder, ForceSensor, Motor, RigDevice
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.parameters import RobotParameters, parameters_of
from stepgap.robots.hopper.sensors import HopperReading, HopperSensorModel
from stepgap.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Contact(ForceSensor):
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
class RigSettings(BusSettings):
    """Settings of the hopper's EtherCAT bus.

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
    motor_1: Motor
    motor_2: Motor
    boom_horizontal: Encoder
    boom_vertical: Encoder
    contact: Contact
    limits: SafetyLimits

    def __post_init__(self) -> None:
        require(isfinite(self.pivot_height), "pivot_height", self.pivot_height, "be finite")
        super().__post_init__()
        require(self.motor_2.slave != self.motor_1.slave, "motor_2.slave", self.motor_2.slave, "differ from motor 1's")
        require(
            self.boom_vertical.slave != self.boom_horizontal.slave,
            "boom_vertical.slave",
            self.boom_vertical.slave,
            "differ from the horizontal angle's",
        )
        require(
            self.motor_2.link_counts == self.motor_1.link_counts,
            "motor_2.counts_per_turn",
            self.motor_2.counts_per_turn,
            f"give with its gear the {self.motor_1.link_counts:g} counts per turn of motor 1",
        )

    @property
    def devices(self) -> Mapping[str, RigDevice]:
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
        """Sensor model for counts to which zeros and signs are already applied.

        Args:
            boom_length: Distance from pivot to hip [m].
        """
        return HopperSensorModel(
            tick=self.tick,
            boom_length=boom_length,
            pivot_height=self.pivot_height,
            motor_counts=self.motor_1.link_counts,
            boom_counts_horizontal=self.boom_horizontal.counts_per_turn,
            boom_counts_vertical=self.boom_vertical.counts_per_turn,
            touchdown_force=self.contact.touchdown_force,
            takeoff_length=self.contact.takeoff_length,
            frames_per_tick=self.frames_per_tick,
            sampled_at_write=True,
        )


def read_rig_settings(path: Path) -> RigSettings:
    """Reads the settings of a rig from a TOML file.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    return build(RigSettings, read_toml(path, "a rig"), lambda name: f"{path}: {with_table(name)}")


def hopper_on_ethercat(settings: RigSettings, robot: RobotParameters, folder: Path = Path()) -> EthercatRig:
    """Rig of these settings, not yet connected; its sensor model uses the robot's boom length.

    Args:
        settings: The settings.
        robot: The robot.
        folder: Folder to which the names of ESI files in the settings are relative.
    """
    return EthercatRig(settings, settings.sensor_model(robot.boom_length), COMPUTER, folder)


def ethercat_rig_from_file(settings: Path, robot: Robot) -> EthercatRig:
    """Rig described by a `rig.toml`; entry point of `stepgap.rigs`.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule. Or the robot is not the hopper.
    """
    return hopper_on_ethercat(read_rig_settings(settings), parameters_of(robot), settings.parent)
