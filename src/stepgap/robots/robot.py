"""The interface of a robot: its settings, state and command, nominal maps, reference, and simulated plants."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np

from stepgap.control.reference import Reference
from stepgap.plants.plant import Plant, RepeatablePlant
from stepgap.plants.tick_control import RobotControl
from stepgap.plants.ticks.stream import OnTicks, thinned
from stepgap.rigs.rig import SensorModel
from stepgap.robots.published_result import PublishedResult
from stepgap.robots.scene import GroundPieces, Kinematics
from stepgap.step import Array, StepMap, StepSpace


class Simulation(ABC):
    """A simulated plant in one world, such as one floor, which is the same in all deployments of a run.

    Attributes:
        unlocked: Whether its plants step without Python's lock, so that several in threads are faster than one.
    """

    unlocked: ClassVar[bool] = False

    @abstractmethod
    def plant(self, rng: np.random.Generator, on_ticks: OnTicks | None = None) -> Plant:
        """Makes the plant of one deployment; the same generator gives the same steps again.

        Args:
            rng: Draws everything that is random in this deployment.
            on_ticks: Called with the ticks, if the plant has any; their columns are those of `Kinematics.units`.
        """

    def observed_plant(self, rng: np.random.Generator, on_ticks: OnTicks, every: int) -> Plant:
        """Makes a plant in this process that takes the same steps, whose ticks also contain the true state.

        Args:
            rng: As of `plant`.
            on_ticks: Called with every `every`-th tick; the columns are those of `Kinematics.observed_units`.
            every: Interval of the reported ticks.
        """
        return self.plant(rng, thinned(on_ticks, every))

    def ground(self, rng: np.random.Generator) -> GroundPieces | None:  # noqa: ARG002  (others use it)
        """The ground of a deployment, to be drawn; None if it is level.

        Args:
            rng: As of `plant`.
        """
        return None

    def repeatable_plant(self, rng: np.random.Generator) -> RepeatablePlant | None:  # noqa: ARG002  (others use it)
        """Makes a plant that can repeat a step, for the noise floor; None if there is none.

        It is called for every target at which a step is repeated; if `unlocked`, in several threads at once.
        """
        return None


class RobotFinding(NamedTuple):
    """What a robot knows of itself before its first run.

    Attributes:
        part: What it is about, a word.
        right: Whether nothing has to be mended.
        sentence: What was found and, if it is wrong, what to do.
    """

    part: str
    right: bool
    sentence: str


@dataclass(frozen=True)
class Robot(ABC):
    """A robot with its settings: a frozen dataclass, each field of which is a table of `experiment.toml`.

    A table is a frozen dataclass with default values, whose `__post_init__` raises ValueError for a wrong value
    (`require` words the message). Only `space` is needed; what a robot does not have, the verbs leave out.

    Attributes:
        name: Name of the robot; that of its entry point.
        presets: Named values of its tables, by table; key `preset` of that table chooses one.
        files: Keys of its tables that name a file, such as `ground.profile`, and whether a run keeps a copy of it.
        plant_titles: What a report calls its simulated plants, by their names; others are called by their names.
        former: Keys of its tables in former versions, such as `gains.lead`, with the only value that has no effect and
            is still read; None for any value.
    """

    name: ClassVar[str]
    presets: ClassVar[Mapping[str, Mapping[str, Any]]] = {}
    files: ClassVar[Mapping[str, bool]] = {}
    plant_titles: ClassVar[Mapping[str, str]] = {}
    former: ClassVar[Mapping[str, Any]] = {}

    @property
    @abstractmethod
    def space(self) -> StepSpace:
        """Names, units and ranges of its state and command."""

    def nominal_maps(self) -> Mapping[str, Callable[[], StepMap]]:
        """Its nominal maps by name; the first one is the default. Of a `SimulatorMap`, a surrogate is used.

        Without any, a template or a log is needed.
        """
        return {}

    def references(self) -> Mapping[str, Callable[[], Reference]]:
        """Its references by name; the first one is the default. Without another, stairs in the ranges of use."""
        return {"stairs": lambda: stairs(self.space)}

    def published(self) -> PublishedResult | None:
        """The published result with which runs along its reference are compared; None if there is none."""
        return None

    def prior(self) -> Path | None:
        """File of the prior over robots of this kind, which `stepgap prior` wrote; None if there is none."""
        return None

    def check(self) -> None:  # noqa: B027  (few robots need it)
        """Raises ValueError, `table.key = value, but it must …`, if settings of different tables do not fit."""

    def simulations(self) -> Mapping[str, Callable[[np.random.Generator], Simulation]]:
        """Its simulated plants by name, made from a generator that draws the world; the first one is the default."""
        return {}

    def findings(self) -> Sequence[RobotFinding]:
        """What `stepgap check` says of its simulation that only a robot of this kind has, such as its gait."""
        return ()

    @property
    def step_seconds(self) -> float | None:
        """Duration of a step [s], which the program of another plant must know; None where it has no fixed one."""
        return None

    @property
    def as_modelled(self) -> Self:
        """This robot with all settings that its nominal maps do not use at their defaults."""
        return self

    def placed(self, state: Array) -> Array | None:  # noqa: ARG002  (others use it)
        """The state that is read from the simulated model after it was put into a state; None if there is no model.

        Args:
            state: State at the section; shape (n,).
        """
        return None

    def control(self) -> RobotControl | None:
        """Its control at 1 kHz, with which a rig becomes a plant; None if it has none."""
        return None

    def kinematics(self, sensors: SensorModel | None = None) -> Kinematics | None:  # noqa: ARG002
        """How it is drawn from its ticks; None if it is not drawn.

        Args:
            sensors: Sensor model of its rig; None for its simulated plants.
        """
        return None

    def randomised(self, rng: np.random.Generator) -> Self | None:  # noqa: ARG002  (others use it)
        """This robot with random differences of its simulated plants from the model; None if there are none."""
        return None


def stairs(space: StepSpace, steps: int = 12) -> Reference:
    """Stairs within 0.4 of the ranges of use of the tracked coordinates, each shifted against the one before.

    Args:
        steps: Number of steps on each stair.
    """
    shares = np.array([0.0, 0.4, -0.2, 0.2, -0.4, 0.0])
    rows = np.full((len(space.state), len(shares)), np.nan)
    rows[space.tracked] = [np.roll(shares, shift) for shift in range(np.count_nonzero(space.tracked))]
    targets = space.state_centre + rows.T * space.state_scale
    segments = [(1 + steps * number, target.tolist()) for number, target in enumerate(targets)]
    return Reference.from_segments(space.state_names, segments, steps=steps * len(targets))
