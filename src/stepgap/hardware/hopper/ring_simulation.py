"""The twin of the hopper behind an emulated EtherCAT ring, as a simulated plant of its own."""

import os
from collections.abc import Callable
from functools import partial
from math import isfinite

import numpy as np

from stepgap.base.errors import InputError
from stepgap.hardware.ethercat.emulator.ring_settings import RingSettings
from stepgap.hardware.hopper.direct_ring import DirectRing
from stepgap.hardware.hopper.ethercat import RigSettings
from stepgap.hardware.hopper.ring_rig import RingRig, emulated_settings
from stepgap.hardware.hopper.twin_machine import TwinMachine
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import Rig
from stepgap.robots.hopper.robot import Hopper
from stepgap.robots.hopper.twin.simulation import HopperSimulation
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model

RING = RingSettings(inputs_after_tick=True)
"""Settings of the emulated ring of a run."""


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
