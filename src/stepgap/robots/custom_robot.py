"""A robot that is described in `experiment.toml` alone: it needs no equations and no Python."""

from dataclasses import dataclass, field
from typing import ClassVar, final

from stepgap.base.ranges import require
from stepgap.robots.robot import Robot
from stepgap.step import ContextQuantity, Quantity, StepSpace


@dataclass(frozen=True)
class Quantities:
    """State, command and context.

    Attributes:
        state: Coordinates of the state at the section.
        command: Coordinates of the command.
        context: What else is measured around a step, each with name, unit and, if it is periodic, its period.
    """

    state: tuple[Quantity, ...] = ()
    command: tuple[Quantity, ...] = ()
    context: tuple[ContextQuantity, ...] = ()


@final
@dataclass(frozen=True)
class CustomRobot(Robot):
    """A robot of which only the state and the command are known; its plant is a program, its nominal map is a file.

    Attributes:
        quantities: State, command and context.
    """

    name: ClassVar[str] = "custom"

    quantities: Quantities = field(default_factory=Quantities)

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the settings."""
        return StepSpace(self.quantities.state, self.quantities.command, self.quantities.context)

    def check(self) -> None:
        """Raises ValueError where a coordinate is missing or is named twice."""
        for kind in ("state", "command", "context"):
            count = len(getattr(self.quantities, kind))
            rule = f"be at least one [[quantities.{kind}]] with name, unit, lower, upper"
            require(count > 0 or kind == "context", f"quantities.{kind}", count, rule)
        names = (*self.space.names, *self.space.context_names)
        require(len(set(names)) == len(names), "quantities", list(names), "have different names")
