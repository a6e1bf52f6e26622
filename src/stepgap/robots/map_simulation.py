"""A simulated plant that is another map of the robot, with noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np

from stepgap.plants.model_plant import ModelPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.robots.robot import Simulation
from stepgap.step import StepMap


@final
@dataclass(frozen=True, eq=False)
class MapSimulation(Simulation):
    """Steps of a map, such as that of the same equations with other parameters. It has no ticks.

    Attributes:
        step_map: True map of the plant.
        start: State in which a deployment starts; n numbers.
        noise: Standard deviation of the noise that is added to every next state; n numbers.
    """

    step_map: StepMap
    start: Sequence[float]
    noise: Sequence[float]

    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> ModelPlant:  # noqa: ARG002
        """Plant of one deployment."""
        return ModelPlant(self.step_map, self.start, self.noise, rng)

    def repeatable_plant(self, rng: np.random.Generator) -> ModelPlant:
        """The same, which can repeat a step."""
        return self.plant(rng)
