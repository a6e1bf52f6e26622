"""A machine behind an emulated ring that needs no simulator."""

from stepgap.hardware.ethercat.emulator.device import EmulatedDevice
from stepgap.hardware.ethercat.emulator.ring import Machine
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.twin_machine import hopper_devices
from stepgap.rigs.rig import Torques
from stepgap.robots.hopper.tick.sensors import HopperReading

POSE = HopperReading(2100, -2050, 77, 330, 1.0)


class JiggedMachine(Machine):
    """A robot in a jig, which does not move, and gets no torque.

    Args:
        period: Time of a tick [s].
    """

    def __init__(self, period: float):
        self._period = period

    @property
    def period(self) -> float:
        return self._period

    def devices(self, settings: RingSettings) -> list[EmulatedDevice]:
        return hopper_devices(settings, self.period)

    def start(self) -> HopperReading:
        return POSE

    def tick(self, torques: Torques) -> HopperReading:
        if any(torques):
            raise AssertionError("it was given a torque")
        return POSE
