"""The simulated plant of the hopper: the twin."""

from abc import abstractmethod
from collections.abc import Callable
from copy import deepcopy
from functools import partial
from math import tau
from typing import ClassVar

import numpy as np

from stepgap.base.errors import InputError
from stepgap.plants.plant import RepeatablePlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.rigs.rig import Rig
from stepgap.robots.ground import FLAT_GROUND, UnevenGround
from stepgap.robots.hopper.parameters import RobotParameters
from stepgap.robots.hopper.tick.hop_control import HopperControl
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.observed_plant import observed_plant
from stepgap.robots.hopper.twin.reality_gap import RealityGap
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.robot import Simulation
from stepgap.robots.scene import GroundPieces
from stepgap.step import Array


class TwinPlant(RigPlant, RepeatablePlant):
    """Plant of the twin, which can repeat a step.

    Args:
        control: Control of the hopper.
        on_ticks: As of `RigPlant`.
    """

    def __init__(self, twin: Twin, control: HopperControl, on_ticks: OnTicks | None = None):
        super().__init__(twin, control, on_ticks)
        self._twin = twin

    def repeated(self, command: Array, rng: np.random.Generator, turned: float = 0.0) -> Array:
        """Next state of a copy that takes a step with new noise, on a floor that was turned."""
        return deepcopy(self, {id(self._twin): self._twin.fork(rng, floor_yaw=turned)}).take_step(command).next_state


class HopperSimulation(Simulation):
    """A simulated plant that contains the twin; the floor is the same in all deployments.

    Args:
        parameters: Robot of the physics model.
        gap: Differences of the twin from it.
        make_control: Makes the control of a plant.
        world: Draws the floor.
        ground: What is uneven besides.

    Raises:
        InputError: No twin can be made with these settings.
    """

    unlocked: ClassVar[bool] = True

    def __init__(
        self,
        parameters: RobotParameters,
        gap: RealityGap,
        make_control: Callable[[], HopperControl],
        world: np.random.Generator,
        ground: UnevenGround = FLAT_GROUND,
    ):
        self.parameters = parameters
        self.make_control = make_control
        profile = GroundProfile(gap, parameters.boom_length, world, ground)
        self.make_twin = partial(_twin, parameters, gap, profile, ground.stone_spacing > 0)
        self.make_twin(np.random.default_rng(0))  # reports errors before the first deployment

    def repeatable_plant(self, rng: np.random.Generator) -> TwinPlant:
        """Plant of the twin itself, which can repeat a step."""
        return TwinPlant(self.make_twin(rng), self.make_control())

    def observed_plant(self, rng: np.random.Generator, on_ticks: OnTicks, every: int) -> RigPlant:
        """Plant whose ticks also contain the true state of the twin."""
        return observed_plant(*self.direct_rig(rng), self.make_control(), on_ticks, every)

    def ground(self, rng: np.random.Generator) -> GroundPieces | None:
        """The treads, turned as under this deployment."""
        _, twin = self.direct_rig(rng)
        return twin.ground_pieces()

    @abstractmethod
    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """A rig in this process that repeats the motion of a deployment tick by tick, and the twin in it.

        It is in its state before the first hop. An emulated ring is left out, and its faults are not reproduced.
        """


class TwinSimulation(HopperSimulation):
    """The twin itself."""

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> TwinPlant:
        """Plant of one deployment."""
        return TwinPlant(self.make_twin(rng), self.make_control(), on_ticks)

    def direct_rig(self, rng: np.random.Generator) -> tuple[Rig, Twin]:
        """The twin, twice."""
        twin = self.make_twin(rng)
        return twin, twin


def _twin(
    parameters: RobotParameters, gap: RealityGap, ground: GroundProfile, stones: bool, rng: np.random.Generator
) -> Twin:
    """Twin of one deployment, on the floor turned by a random angle, or on the first of its stones."""
    floor_yaw = rng.uniform(0, tau)  # otherwise every deployment would reach a target at the same yaw
    floor_yaw = 0.0 if stones else floor_yaw
    try:
        return Twin(parameters, gap, rng, ground=ground, floor_yaw=floor_yaw)
    except ValueError as error:
        raise InputError(f"no twin can be made with the settings [parameters], [gap] and [ground]: {error}") from None
