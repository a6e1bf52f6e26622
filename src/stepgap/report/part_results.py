"""Results of the tests of the parts of a robot: a verdict, and a sentence with what to do."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from stepgap.base.errors import StepGapError
from stepgap.records.text import capitalised
from stepgap.step import Array, StepSpace

Verdict = Literal["ok", "wrong", "left out"]
"""Result of the test of a part."""


@dataclass(frozen=True)
class PartResult:
    """The result of the test of one part of a robot.

    Attributes:
        part: The part.
        verdict: The result.
        sentence: What was found and, if it is wrong, what to do.
    """

    part: str
    verdict: Verdict
    sentence: str


def results_of(part: str, results: Iterator[PartResult]) -> list[PartResult]:
    """The results for a part; an explained error ends them with one more, which is wrong."""
    found = list[PartResult]()
    try:
        found.extend(results)
    except StepGapError as error:
        found.append(PartResult(part, "wrong", f"{capitalised(str(error))}."))
    return found


def half_ranges(space: StepSpace, values: Array) -> str:
    """A number of half ranges for each state coordinate as text."""
    return ", ".join(f"{name} {value:.2g}" for name, value in zip(space.state_names, values, strict=True))
