"""The simulated plants of the hopper: the twin, also behind an emulated EtherCAT ring."""

import os
from abc import abstractmethod
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from math import isfinite, tau
from typing import TYPE_CHECKING

import numpy as np

from stepgap.base.errors import InputError
from stepgap.plants.plant import RepeatablePlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Rig
from stepgap.robots.hopper.direct_ring import DirectRing
from stepgap.robots.hopper.ethercat import RigSettings
from stepgap.robots.hopper.observed_plant import observed_plant
from stepgap.robots.hopper.ring_rig import RingRig, emulated_settings
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model
from stepgap.robots.hopper.twin_machine import TwinMachine
from stepgap.robots.robot import Simulation
from stepgap.step import Array

if TYPE_CHECKING:
    from stepgap.robots.hopper.robot import Hopper

RING = RingSettings(inputs_after_tick=True)
"""Settings of the emulated ring of a run."""


class TwinPlant(RigPlant, RepeatablePlant):
    """Plant of the twin, which can repeat a step.

    Args:
        twin: The twin.
        hopper: Robot whose control it has.
        on_ticks: As of `RigPlant`.
    """

    def __init__(self, twin: Twin, hopper: "Hopper", on_ticks: OnTicks | None = None):
        super().__init__(twin, hopper.control(), on_ticks)
        self._twin = twin

    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:
        """Next state of a copy that takes a step with new noise, on a floor that was turned."""
        return deepcopy(self, {id(self._twin): self._twin.fork(rng, floor_yaw=turned)}).take_step(command).next_state


class HopperSimulation(Simulation):
    """A simulated plant that contains the twin; the floor is the same in all deployments.

    Args:
        hopper: The robot, with the differences of the twin.
        world: Draws the floor.

    Raises:
        InputError: No twin can be made with these settings.
    """

    def __init__(self, hopper: "Hopper", world: np.random.Generator):
        self.hopper = hopper
        self._make_twin = partial(_twin, hopper, GroundProfile(hopper.gap, hopper.parameters.boom_length, world))
        self._make_twin(np.random.default_rng(0))  # reports errors before the first deployment

    def repeatable_plant(self, rng: np.random.Generator) -> TwinPlant:
        """Plant of the twin itself, which can repeat a step."""
        return TwinPlant(self._make_twin(rng), self.hopper)

    def observed_plant(self, rng: np.random.Generator, on_ticks: OnTicks, every: int) -> RigPlant:
        """Plant whose ticks also contain the true state of the twin."""
        return observed_plant(*self.direct_rig(rng), self.hopper.control(), on_ticks, every)

    @abstractmethod
    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """A rig in this process that repeats the motion of a deployment tick by tick, and the twin in it.

        It is in its state before the first hop. An emulated ring is left out, and its faults are not reproduced.
        """


class TwinSimulation(HopperSimulation):
    """The twin itself."""

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> TwinPlant:
        """Plant of one deployment."""
        return TwinPlant(self._make_twin(rng), self.hopper, on_ticks)

    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """The twin, twice."""
        twin = self._make_twin(rng)
        return twin, twin


class RingSimulation(HopperSimulation):
    """The twin behind the drives of an emulated EtherCAT ring, which runs in another process."""

    def __init__(self, hopper: "Hopper", world: np.random.Generator):
        super().__init__(hopper, world)
        for name in ("motor_counts", "boom_counts_horizontal", "boom_counts_vertical"):
            if not isfinite(getattr(hopper.gap, name)):
                raise InputError(f"gap.{name} must be finite: a ring carries integer counts, such as {name} = 16384")
        sensors = twin_sensor_model(hopper.parameters, hopper.gap)
        interface = f"sg{os.getpid()}"  # several runs may be active
        self._bus: RigSettings = emulated_settings(sensors, hopper.parameters, RING, interface)

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> RigPlant:
        """Plant of one deployment, whose ring begins with it."""
        rig = RingRig(partial(_machine, self._make_twin, rng), RING, self._bus, self.hopper.parameters)
        return RigPlant(rig, self.hopper.control(), on_ticks)

    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """A rig with the counts and limits of the ring, and its twin."""
        twin = self._make_twin(rng)
        return DirectRing(twin, RING, self._bus), twin


def _twin(hopper: "Hopper", ground: GroundProfile, rng: np.random.Generator) -> Twin:
    """Twin of one deployment, on the floor turned by a random angle."""
    floor_yaw = rng.uniform(0, tau)  # otherwise every deployment would reach a target at the same yaw
    try:
        return Twin(hopper.parameters, hopper.gap, rng, ground=ground, floor_yaw=floor_yaw)
    except ValueError as error:
        raise InputError(f"no twin can be made with the settings [parameters] and [gap]: {error}") from None


def _machine(make: Callable[[np.random.Generator], Twin], rng: np.random.Generator) -> TwinMachine:
    """Machine behind the drives of an emulated ring; called in the ring's process."""
    return TwinMachine(make(rng))
