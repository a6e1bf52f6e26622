"""The twin as it behaves behind an emulated ring, called directly: no second process, no network, no special rights."""

from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ethercat import RigSettings
from stepgap.rigs.rig import Rig, Torques
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin.twin import Twin

SHORT = 2**15
"""An analog input counts from −SHORT to SHORT − 1."""


class DirectRing(Rig):
    """The twin called directly; it moves tick by tick as behind a `RingRig` without faults.

    Torques and contact force are in the ring's counts, and the drives are enabled in a tick without torque.

    Args:
        twin: The simulated robot.
        ring: Scales of torque and force.
        settings: Settings that the master of such a ring would use.
    """

    def __init__(self, twin: Twin, ring: RingSettings, settings: RigSettings):
        self._twin, self._ring, self._settings = twin, ring, settings

    @property
    def sensor_model(self) -> HopperSensorModel:
        """Sensor model of the twin."""
        return self._twin.sensor_model

    @property
    def limits(self) -> SafetyLimits:
        """Safety limits of the settings."""
        return self._settings.limits

    def connect(self) -> None:
        """Connects the twin and passes the tick in which the drives are enabled."""
        self._twin.connect()
        self._twin.write((0.0, 0.0))

    def read(self) -> HopperReading:
        """Sensor values of the twin; the contact force is rounded to counts of the analog input."""
        reading, unit = self._twin.read(), self._ring.force_resolution
        counts = min(max(round(reading.contact_force / unit), -SHORT), SHORT - 1)
        return reading._replace(contact_force=unit * counts)

    def write(self, torques: Torques) -> tuple[float, float]:
        """Commands torques within limits, rounded to thousandths of the rated torque [N·m], and returns them."""
        motor = self._settings.motor_1
        unit, most = motor.torque_unit, motor.most_units
        units = [round(min(max(torque / unit, -most), most)) for torque in torques]
        self._twin.write(tuple(count * self._ring.rated_torque * 1e-6 for count in units))
        return units[0] * unit, units[1] * unit

    def close(self) -> None:
        """Switches torque off."""
        self._twin.close()
