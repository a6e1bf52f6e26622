"""The hopper on two moteus controllers with boom encoders and contact at their auxiliary ports (`moteus.toml`)."""

from dataclasses import dataclass
from pathlib import Path

from stepgap.base.ranges import require
from stepgap.base.settings_file import build_from_file
from stepgap.hardware.hopper.rig_settings import ContactThresholds, HopperRigSettings
from stepgap.hardware.moteus.moteus_rig import POSITION_COUNTS, MoteusRig
from stepgap.hardware.moteus.moteus_settings import AuxEncoder, AuxForce, CanSettings, Controller
from stepgap.rigs.rig import SensorModel
from stepgap.robots.hopper.parameters import RobotParameters, parameters_of
from stepgap.robots.robot import Robot


@dataclass(frozen=True, kw_only=True)
class AuxContact(ContactThresholds, AuxForce):
    """Settings of the contact force sensor."""

    def __post_init__(self) -> None:
        AuxForce.__post_init__(self)
        ContactThresholds.__post_init__(self)


@dataclass(frozen=True, kw_only=True)
class MoteusSettings(HopperRigSettings, CanSettings):
    """Settings of the hopper's CAN bus."""

    motor_1: Controller
    motor_2: Controller
    boom_horizontal: AuxEncoder
    boom_vertical: AuxEncoder
    contact: AuxContact

    def __post_init__(self) -> None:
        HopperRigSettings.__post_init__(self)
        CanSettings.__post_init__(self)
        gears = (self.motor_1.gear, self.motor_2.gear)
        require(gears[1] == gears[0], "motor_2.gear", gears[1], f"be that of motor 1, {gears[0]:g}")
        yaw = self.boom_horizontal
        pitch = self.boom_vertical
        differs = (pitch.id, pitch.source) != (yaw.id, yaw.source)
        require(differs, "boom_vertical.source", pitch.source, "differ from the horizontal angle's")

    @property
    def timing(self) -> SensorModel:
        """Sensors are sampled at the read."""
        return SensorModel(tick=self.tick)

    @property
    def motor_counts(self) -> float:
        """Counts of a motor's encoder per turn of its top link."""
        return POSITION_COUNTS * self.motor_1.gear


def read_moteus_settings(path: Path) -> MoteusSettings:
    """Reads the settings of a rig from a TOML file.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule.
    """
    return build_from_file(MoteusSettings, path, "a rig")


def hopper_on_moteus(settings: MoteusSettings, robot: RobotParameters) -> MoteusRig:
    """Rig of these settings, not yet connected; its sensor model uses the robot's boom length."""
    return MoteusRig(settings, settings.sensor_model(robot.boom_length))


def moteus_rig_from_file(settings: Path, robot: Robot) -> MoteusRig:
    """Rig described by a `moteus.toml`; entry point of `stepgap.rigs`.

    Raises:
        InputError: A setting is wrong; the message names file, key and rule. Or the robot is not the hopper.
    """
    return hopper_on_moteus(read_moteus_settings(settings), parameters_of(robot))
