"""The twin of the hopper behind an emulated EtherCAT ring, as a simulated plant of its own."""

import os
from collections.abc import Callable
from functools import partial
from math import isfinite

import numpy as np

from stepgap.base.errors import InputError
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.ethercat import RigSettings
from stepgap.hardware.hopper.ring_rig import RingRig, emulated_settings
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import Rig, Torques
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.tick.limits import SafetyLimits
from stepgap.robots.hopper.tick.sensors import HopperReading, HopperSensorModel
from stepgap.robots.hopper.twin.simulation import HopperSimulation
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model

SHORT = 2**15  # An analog input counts from −SHORT to SHORT − 1


class DirectRing(Rig):
    """The twin called directly; it moves tick by tick as behind a `RingRig` without faults.

    Torques and contact force are in the ring's counts, and the drives are enabled in a tick without torque.

    Args:
        ring: Scales of torque and force.
        settings: Settings that the master of such a ring would use.
    """

    def __init__(self, twin: Twin, ring: RingSettings, settings: RigSettings):
        self._twin = twin
        self._ring = ring
        self._settings = settings

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
        reading = self._twin.read()
        unit = self._ring.force_resolution
        counts = min(max(round(reading.contact_force / unit), -SHORT), SHORT - 1)
        return reading._replace(contact_force=unit * counts)

    def write(self, torques: Torques) -> tuple[float, float]:
        """Commands torques within limits, rounded to thousandths of the rated torque [N·m], and returns them."""
        motor = self._settings.motor_1
        unit = motor.torque_unit
        most = motor.most_units
        units = [round(min(max(torque / unit, -most), most)) for torque in torques]
        self._twin.write(tuple(count * self._ring.rated_torque * 1e-6 for count in units))
        return units[0] * unit, units[1] * unit

    def close(self) -> None:
        """Switches torque off."""
        self._twin.close()


RING = RingSettings(inputs_after_tick=True)  # Settings of the emulated ring of a run


class RingSimulation(HopperSimulation):
    """The twin behind the drives of an emulated EtherCAT ring, which runs in another process."""

    def __init__(self, hopper: Hopper, world: np.random.Generator):
        super().__init__(hopper.parameters, hopper.gap, hopper.control, world, hopper.ground)
        for name in ("motor_counts", "boom_counts_horizontal", "boom_counts_vertical"):
            if not isfinite(getattr(hopper.gap, name)):
                raise InputError(f"gap.{name} must be finite: a ring carries integer counts, such as {name} = 16384")
        sensors = twin_sensor_model(hopper.parameters, hopper.gap)
        interface = f"sg{os.getpid()}"  # several runs may be active
        self._bus: RigSettings = emulated_settings(sensors, hopper.parameters, RING, interface, hopper.ground)

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> RigPlant:
        """Plant of one deployment, whose ring begins with it."""
        rig = RingRig(partial(_machine, self.make_twin, rng), RING, self._bus, self.parameters)
        return RigPlant(rig, self.make_control(), on_ticks)

    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """A rig with the counts and limits of the ring, and its twin."""
        twin = self.make_twin(rng)
        return DirectRing(twin, RING, self._bus), twin


def _machine(make: Callable[[np.random.Generator], Twin], rng: np.random.Generator) -> TwinMachine:
    """Machine behind the drives of an emulated ring; called in the ring's process."""
    return TwinMachine(make(rng))
