"""What the twin behind an emulated ring does, without the ring: in this process, and with no rights asked for."""

from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Rig, Torques
from stepgap.robots.hopper.ethercat import RigSettings
from stepgap.robots.hopper.limits import SafetyLimits
from stepgap.robots.hopper.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin.twin import Twin

SHORT = 2**15
"""An analog input counts from −this up to one less."""


class DirectRing(Rig):
    """The twin called directly, tick by tick as `RingRig` moves it while the ring has no faults.

    Torques and contact force are in the ring's counts, and the drives are enabled in a tick without torque.

    Args:
        twin: What hops.
        ring: Scales of torque and force.
        settings: What the master would be told.
    """

    def __init__(self, twin: Twin, ring: RingSettings, settings: RigSettings):
        self._twin, self._ring, self._settings = twin, ring, settings

    @property
    def sensor_model(self) -> HopperSensorModel:
        """The twin's."""
        return self._twin.sensor_model

    @property
    def limits(self) -> SafetyLimits:
        """The settings'."""
        return self._settings.limits

    def connect(self) -> None:
        """The twin after the tick in which its drives are enabled."""
        self._twin.connect()
        self._twin.write((0.0, 0.0))

    def read(self) -> HopperReading:
        """The twin's sensor values, the contact force in counts of the analog input."""
        reading, unit = self._twin.read(), self._ring.force_resolution
        counts = min(max(round(reading.contact_force / unit), -SHORT), SHORT - 1)
        return reading._replace(contact_force=unit * counts)

    def write(self, torques: Torques) -> tuple[float, float]:
        """Commands whole thousandths of the rated torque, within limits [N·m], and returns them."""
        motor = self._settings.motor_1
        unit, most = motor.torque_unit, motor.most_units
        units = [round(min(max(torque / unit, -most), most)) for torque in torques]
        self._twin.write(tuple(count * self._ring.rated_torque * 1e-6 for count in units))
        return units[0] * unit, units[1] * unit

    def close(self) -> None:
        """Torque off."""
        self._twin.close()
