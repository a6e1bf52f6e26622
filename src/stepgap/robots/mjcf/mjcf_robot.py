"""A robot that is a MuJoCo model with a controller: what its user writes, and what follows from it."""

# pyright: reportAttributeAccessIssue=false
# (MuJoCo ships no types for its compiled part.)

from abc import abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from stepgap.rigs.rig import SensorModel
from stepgap.robots.mjcf.mjcf_gap import MjcfGap
from stepgap.robots.mjcf.mjcf_kinematics import MjcfKinematics
from stepgap.robots.mjcf.mjcf_step import ControlLaw, MjcfSimulation, MjcfSimulator
from stepgap.robots.mjcf.section import Section
from stepgap.robots.nominal_maps.simulator import SimulatorMap
from stepgap.robots.robot import Robot, Simulation
from stepgap.step import Array, StepMap


@dataclass(frozen=True)
class MjcfRobot(Robot):
    """A robot from a MuJoCo model. Its nominal map is the simulated model, its plant the model with a reality gap.

    Attributes:
        gap: Differences of the plant from the model.
        tick: Time between two calls of the controller [s]; a class attribute.
        longest_step: Time after which a step has failed [s]; a class attribute.
    """

    gap: MjcfGap = field(default_factory=MjcfGap)

    tick = 0.002
    longest_step = 3.0

    @abstractmethod
    def mjcf_model(self) -> Any:
        """The model, such as `mujoco.MjModel.from_xml_path("robot.xml")`; made again for every deployment."""

    @abstractmethod
    def controller(self) -> ControlLaw:
        """A new controller for a tick, which writes `data.ctrl`; it may keep its memory in a closure or an object."""

    @abstractmethod
    def section(self) -> Section:
        """When a step ends: `section.apex`, `section.touchdown`, or a `Section` with a function of your own."""

    @abstractmethod
    def state(self, model: Any, data: Any) -> Array:
        """The state at the section; shape (n,)."""

    @abstractmethod
    def place(self, model: Any, data: Any, state: Array) -> None:
        """Puts the model at the section, in this state; it was reset before."""

    def failed(self, model: Any, data: Any) -> bool:  # noqa: ARG002  (others use them)
        """Whether the robot has fallen."""
        return False

    @property
    def as_modelled(self) -> Self:
        """This robot with the default gap."""
        return replace(self, gap=type(self)().gap)

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The simulator."""
        return {"simulator": lambda: SimulatorMap(self.space, MjcfSimulator(self))}

    def simulations(self) -> Mapping[str, Callable[[np.random.Generator], Simulation]]:
        """The model with its gap."""
        return {"mujoco": lambda world: MjcfSimulation(self)}

    def kinematics(self, sensors: SensorModel | None = None) -> MjcfKinematics:  # noqa: ARG002
        """The geoms of the model."""
        return MjcfKinematics(self)

    def randomised(self, rng: np.random.Generator) -> Self:
        """This robot with a random gap."""
        return replace(self, gap=MjcfGap.random(rng))
