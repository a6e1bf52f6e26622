"""The hopper as a `Robot`: its settings, and what they make."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from math import tau
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from stepgap.base.errors import InputError
from stepgap.control.reference import Reference
from stepgap.rigs.rig import SensorModel
from stepgap.robots.ground import UnevenGround
from stepgap.robots.hopper.footholds import random_strides, stones_reference
from stepgap.robots.hopper.paper import paper_reference, paper_result
from stepgap.robots.hopper.parameters import CommandBounds, Gains, RobotParameters
from stepgap.robots.hopper.twin.reality_gap import PAPER_FAMILY, RealityGap
from stepgap.robots.published_result import PublishedResult
from stepgap.robots.robot import Robot
from stepgap.step import StepMap, StepSpace

if TYPE_CHECKING:  # they load Numba and MuJoCo, which the settings do not need
    from stepgap.robots.hopper.kinematics import HopperKinematics
    from stepgap.robots.hopper.tick.hop_control import HopperControl
    from stepgap.robots.hopper.twin.simulation import HopperSimulation

TWIN = "twin"  # Name of the simulated plant

FORMER_BOUNDS = (
    "command.thrust_rest_length",
    "command.thrust_stiffness",
    "command.rest_length",
    "command.stiffness",
    "command.landing_length",
    "command.speed_setpoint",
    "command.speed_gain",
)
"""Keys of the bounds of gains that could be the step command in former versions; they had no effect on fx and fy."""


@dataclass(frozen=True)
class Hopper(Robot):
    """The hopper on a boom.

    Attributes:
        parameters: Robot of the physics model.
        gains: Gains of the joint controller.
        command: Bounds of the step command.
        gap: Differences of the twin from the model.
        ground: The twin's ground, where it is uneven.
    """

    name: ClassVar[str] = "hopper"
    presets: ClassVar[Mapping[str, Mapping[str, RealityGap]]] = {
        "gap": {"paper": RealityGap(), "none": RealityGap.none(), **PAPER_FAMILY}
    }
    files: ClassVar[Mapping[str, bool]] = {"ground.profile": True}
    plant_titles: ClassVar[Mapping[str, str]] = {TWIN: "simulated twin"}
    former: ClassVar[Mapping[str, Any]] = {
        "command.pair": ["fx", "fy"],
        "gains.thrust_rest_length": 0.0,
        "gains.thrust_stiffness": 0.0,
        **dict.fromkeys(FORMER_BOUNDS),
    }

    parameters: RobotParameters = field(default_factory=RobotParameters)
    gains: Gains = field(default_factory=Gains)
    command: CommandBounds = field(default_factory=CommandBounds)
    gap: RealityGap = field(default_factory=RealityGap)
    ground: UnevenGround = field(default_factory=UnevenGround)

    @property
    def space(self) -> StepSpace:
        """State [speed, height], command [fx, fy]; on uneven ground, the height above what the foot finds."""
        return self.command.space(self.ground)

    def apex_map(self) -> StepMap:
        """Map of the physics model; with footholds, its state also has the stride."""
        from stepgap.robots.hopper.model.apex_map import ApexMap

        if not self.ground.has_footholds:
            return ApexMap(self.parameters, self.gains, self.command, ground=self.ground)
        from stepgap.robots.hopper.model.foothold_map import FootholdMap

        apexes = ApexMap(self.parameters, self.gains, self.command)
        return FootholdMap(apexes, self.parameters, self.gains, self.command, self.ground)

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """The equations of motion."""
        return {"equations": self.apex_map}

    @property
    def as_modelled(self) -> Self:
        """This robot with the default differences of the twin."""
        return replace(self, gap=RealityGap())

    def references(self) -> Mapping[str, Callable[[], Reference]]:
        """The reference of the paper; with footholds, random strides, or those to the stones of the ground."""
        if not self.ground.has_footholds:
            return {"paper": paper_reference}
        if not self.ground.stone_spacing:
            return {"strides": random_strides}
        length = tau * self.parameters.boom_length
        return {"stones": lambda: stones_reference(self.ground.stones(length), length), "strides": random_strides}

    def published(self) -> PublishedResult | None:
        """The result of the paper, whose robot did not track footholds."""
        return None if self.ground.has_footholds else paper_result()

    def check(self) -> None:
        """Raises ValueError where a gain does not fit the leg."""
        try:
            self.gains.check(self.parameters)
        except ValueError as error:
            raise ValueError(f"gains.{error}") from None

    def simulations(self) -> "Mapping[str, Callable[[np.random.Generator], HopperSimulation]]":
        """The twin."""
        return {TWIN: self._twin}

    def _twin(self, world: np.random.Generator) -> "HopperSimulation":
        from stepgap.robots.hopper.twin.simulation import TwinSimulation

        return TwinSimulation(self.parameters, self.gap, self.control, world, self.ground)

    def control(self) -> "HopperControl":
        """The joint controller."""
        from stepgap.robots.hopper.tick.hop_control import HopperControl

        return HopperControl(self.parameters, self.gains, self.command, ground=self.ground)

    def prior(self) -> Path | None:
        """That of 76 random twins (`benchmarks/priors.py`); none with footholds, which are another state."""
        return None if self.ground.has_footholds else Path(__file__).with_name("prior.json")

    def kinematics(self, sensors: SensorModel | None = None) -> "HopperKinematics":
        """Kinematics of boom and leg with the sensors of a rig, or with those of the twin."""
        from stepgap.robots.hopper.kinematics import HopperKinematics
        from stepgap.robots.hopper.tick.sensors import hopper_sensors
        from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model

        model = twin_sensor_model(self.parameters, self.gap) if sensors is None else hopper_sensors(sensors)
        return HopperKinematics(self.parameters, self.gains, model)

    def randomised(self, rng: np.random.Generator) -> Self:
        """A twin of the family of random twins."""
        return replace(self, gap=RealityGap.random(rng))


def as_hopper(robot: Robot, what: str) -> Hopper:
    """The robot, if it is the hopper.

    Args:
        what: What needs the hopper, for the message.

    Raises:
        InputError: It is another robot.
    """
    if not isinstance(robot, Hopper):
        raise InputError(f"robot '{robot.name}': {what} only for robot '{Hopper.name}'")
    return robot
