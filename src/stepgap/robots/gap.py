"""The reality gap of a simulated robot: its differences from the model, each declared in one place."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from math import inf, isfinite, isnan
from typing import Any, NamedTuple, Self

import numpy as np

from stepgap.base.ranges import require


class Rule(NamedTuple):
    """A condition on the value of a difference.

    Attributes:
        holds: Whether a value meets it.
        text: How an error words it, after "it must".
    """

    holds: Callable[[float], bool]
    text: str


POSITIVE = Rule(lambda value: value > 0, "be positive")
NOT_NEGATIVE = Rule(lambda value: value >= 0, "not be negative")


def within(limit: float, text: str) -> Rule:
    """The size of the value, of either sign, is less than a limit."""
    return Rule(lambda value: abs(value) < limit, text)


class Drawn(NamedTuple):
    """Range from which random robots draw a number uniformly: a value, or a share of the default's difference.

    Attributes:
        lowest: Lower end.
        highest: Upper end.
        signed: Whether the sign of half of the numbers is changed.
    """

    lowest: float
    highest: float
    signed: bool = False

    def number(self, rng: np.random.Generator) -> float:
        """Draws a number."""
        number = rng.uniform(self.lowest, self.highest)
        return -number if self.signed and rng.random() < 0.5 else number


@dataclass(frozen=True)
class Difference:
    """What is known of a difference beside its default.

    Attributes:
        exact: Value with which the simulated robot is exactly its model; None if the value is no difference by itself.
        rules: Conditions on the value.
        drawn: Range of the number that random robots draw; None if they have the default.
        whole: Usual value, of which a share may be drawn; signatures of `stepgap explain` begin with it.
    """

    exact: float | None
    rules: tuple[Rule, ...]
    drawn: Drawn | None
    whole: float


def difference(
    default: float, *rules: Rule, exact: float | None = None, drawn: Drawn | None = None, whole: float | None = None
) -> Any:
    """Declares a difference as a field of a `Gap`; the docstring below the field is its meaning, with its unit.

    Args:
        default: Value of the default robot.
        rules: As of `Difference`; without any, every finite number is valid, and infinity where it is `exact`.
        exact: As of `Difference`.
        drawn: As of `Difference`.
        whole: As of `Difference`; by default the default.
    """
    declared = Difference(exact, rules, drawn, default if whole is None else whole)
    return field(default=default, metadata={Difference: declared})


def differences(gap: "Gap | type[Gap]") -> Mapping[str, Difference]:
    """The differences that a gap has, by name, in the order in which random robots draw them."""
    return {entry.name: entry.metadata[Difference] for entry in fields(gap) if Difference in entry.metadata}


@dataclass(frozen=True)
class Gap:
    """Differences of a simulated robot from its model; a subclass declares each as a field by `difference`.

    Raises:
        ValueError: A value is not valid.
    """

    def __post_init__(self) -> None:
        for name, declared in differences(self).items():
            value = getattr(self, name)
            require(not isnan(value), name, value, "be a number")
            require(isfinite(value) or declared.exact == value == inf, name, value, "be finite")
            for rule in declared.rules:
                require(rule.holds(value), name, value, rule.text)

    @classmethod
    def none(cls) -> Self:
        """All differences at their exact values: the simulated robot is its model."""
        exact = {name: declared.exact for name, declared in differences(cls).items()}
        return cls(**{name: value for name, value in exact.items() if value is not None})

    @classmethod
    def draw(cls, rng: np.random.Generator) -> dict[str, float]:
        """Draws a number for each difference that has a range, independently; the class says what it is."""
        return {name: declared.drawn.number(rng) for name, declared in differences(cls).items() if declared.drawn}
