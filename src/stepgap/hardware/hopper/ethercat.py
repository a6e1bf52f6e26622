"""The hopper on an EtherCAT bus: two drives, two boom encoders and a contact force, as `rig.toml` describes them."""

from dataclasses import dataclass
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build_from_file
from stepgap.hardware.ethercat.distributed_clocks import COMPUTER
from stepgap.hardware.ethercat.ethercat_rig import EthercatRig
from stepgap.hardware.ethercat.rig_settings import BusSettings, Encoder, ForceSensor, Motor
from stepgap.hardware.hopper.rig_settings import ContactThresholds, HopperRigSettings
from stepgap.rigs.rig import SensorModel
from stepgap.robots.hopper.parameters import RobotParameters, parameters_of
from stepgap.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class Contact(ContactThresholds, ForceSensor):
    """Settings of the contact force sensor."""

    def __post_init__(self) -> None:
        ForceSensor.__post_init__(self)
        ContactThresholds.__post_init__(self)


@dataclass(frozen=True, kw_only=True)
class RigSettings(HopperRigSettings, BusSettings):
    """Settings of the hopper's EtherCAT bus."""

    motor_1: Motor
    motor_2: Motor
    boom_horizontal: Encoder
    boom_vertical: Encoder
    contact: Contact

    def __post_init__(self) -> None:
        HopperRigSettings.__post_init__(self)
        BusSettings.__post_init__(self)
        drive = self.motor_2.slave
        pitch = self.boom_vertical.slave
        counts = self.motor_2.counts_per_turn
        require(drive != self.motor_1.slave, "motor_2.slave", drive, "differ from motor 1's")
        require(pitch != self.boom_horizontal.slave, "boom_vertical.slave", pitch, "differ from the horizontal angle's")
        rule = f"give with its gear the {self.motor_1.link_counts:g} counts per turn of motor 1"
        require(self.motor_2.link_counts == self.motor_1.link_counts, "motor_2.counts_per_turn", counts, rule)

    @property
    def timing(self) -> SensorModel:
        """Sensors are sampled by the frame of the last write."""
        return SensorModel(tick=self.tick, frames_per_tick=self.frames_per_tick, sampled_at_write=True)

    @property
    def motor_counts(self) -> float:
        """Counts of a motor's encoder per turn of its top link."""
        return self.motor_1.link_counts


def read_rig_settings(path: Path) -> RigSettings:
    """Reads the settings of a rig from a TOML file.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    return build_from_file(RigSettings, path, "a rig")


def hopper_on_ethercat(settings: RigSettings, robot: RobotParameters, folder: Path = Path()) -> EthercatRig:
    """Rig of these settings, not yet connected; names of ESI files in them are relative to a folder."""
    return EthercatRig(settings, settings.sensor_model(robot.boom_length), COMPUTER, folder)


def ethercat_rig_from_file(settings: Path, robot: Robot) -> EthercatRig:
    """Rig described by a `rig.toml`; entry point of `stepgap.rigs`.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule. Or the robot is not the hopper.
    """
    return hopper_on_ethercat(read_rig_settings(settings), parameters_of(robot), settings.parent)
