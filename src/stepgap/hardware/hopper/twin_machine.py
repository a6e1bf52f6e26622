"""The twin behind the drives of an emulated ring, and the devices of that ring."""

from operator import attrgetter
from typing import TYPE_CHECKING

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.drive import Drive, DriveSettings
from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.ethercat.emulator.terminals import COUPLER_IDENTITY, AnalogInput, EncoderTerminal
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.tick.sensors import HopperReading

if TYPE_CHECKING:  # the devices alone need no simulator, whose import is slow
    from stepgap.robots.hopper.twin.twin import Twin


def hopper_devices(settings: RingSettings, period: float, motor_counts: float = 16384.0) -> list[EmulatedDevice]:
    """Devices of the ring in order: drive_1, drive_2, coupler, boom_horizontal, boom_vertical, contact_force.

    Args:
        settings: Torque and force scales.
        period: Time of a tick [s].
        motor_counts: Counts of a motor per turn.
    """
    drive = DriveSettings(
        rated_torque=settings.rated_torque,
        largest_torque=settings.largest_torque,
        period=period,
        counts_per_turn=motor_counts,
    )
    return [
        *(Drive(f"drive_{motor}", drive, attrgetter(f"motor_{motor}")) for motor in (1, 2)),
        EmulatedDevice("coupler", COUPLER_IDENTITY),
        *(EncoderTerminal(name, attrgetter(name)) for name in ("boom_horizontal", "boom_vertical")),
        AnalogInput("contact_force", attrgetter("contact_force"), settings.force_resolution),
    ]


class TwinMachine(Machine):
    """The MuJoCo twin behind the drives.

    Args:
        twin: Twin whose sensors must be quantised, since a ring carries integer counts; exact values are rounded.
    """

    def __init__(self, twin: "Twin"):
        self._twin = twin

    @property
    def period(self) -> float:
        """Time of a tick [s]."""
        return self._twin.sensor_model.tick

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        """Two drives, a coupler, two boom encoders and an analog input."""
        return hopper_devices(settings, self.period, self._twin.sensor_model.motor_counts)

    def start(self) -> HopperReading:
        """Puts the twin into its starting pose, held."""
        self._twin.connect()
        return self._twin.read()

    def tick(self, torques: Torques) -> HopperReading:
        """Moves the twin by one tick.

        Raises:
            RigFault: A motor is too fast, or the motion cannot be measured.
        """
        self._twin.write(torques)
        return self._twin.read()
