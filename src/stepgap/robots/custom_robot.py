"""A robot that is described in `experiment.toml` alone: it needs no equations and no Python."""

from dataclasses import dataclass, field
from math import isfinite
from typing import ClassVar, final

from stepgap.base.ranges import require
from stepgap.robots.robot import Robot
from stepgap.step import Quantity, StepSpace


@dataclass(frozen=True)
class Coordinate:
    """A coordinate of the state or the command.

    Attributes:
        name: Name, as in files and in the lines of a program.
        unit: SI unit.
        lower: Lower end of the range of use; of a command, a hard bound.
        upper: Upper end.
    """

    name: str
    unit: str
    lower: float
    upper: float

    def __post_init__(self) -> None:
        require(self.name.isidentifier(), "name", self.name, "consist of letters, digits and underscores")
        require(isfinite(self.lower), "lower", self.lower, "be finite")
        require(isfinite(self.upper) and self.lower < self.upper, "upper", self.upper, f"exceed lower = {self.lower:g}")

    @property
    def quantity(self) -> Quantity:
        """The same for a `StepSpace`."""
        return Quantity(self.name, self.unit, self.lower, self.upper)


@dataclass(frozen=True)
class Quantities:
    """State and command.

    Attributes:
        state: Coordinates of the state at the section.
        command: Coordinates of the command.
    """

    state: tuple[Coordinate, ...] = ()
    command: tuple[Coordinate, ...] = ()


@final
@dataclass(frozen=True)
class CustomRobot(Robot):
    """A robot of which only the state and the command are known; its plant is a program, its nominal map is a file.

    Attributes:
        quantities: State and command.
    """

    name: ClassVar[str] = "custom"

    quantities: Quantities = field(default_factory=Quantities)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the settings."""
        return StepSpace(
            tuple(each.quantity for each in self.quantities.state),
            tuple(each.quantity for each in self.quantities.command),
        )

    def check(self) -> None:
        """Raises ValueError where a coordinate is missing or named twice."""
        names = [each.name for each in (*self.quantities.state, *self.quantities.command)]
        for kind in ("state", "command"):
            given = len(getattr(self.quantities, kind))
            wanted = f"be at least one [[quantities.{kind}]] with name, unit, lower, upper"
            require(given > 0, f"quantities.{kind}", given, wanted)
        require(len(set(names)) == len(names), "quantities", names, "have different names")
