"""Cases: independent computations that are numbered from 0."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any, NamedTuple, Protocol

from stepgap.base.errors import StepGapError

LONGEST_REASON = 500  # Longest reason of a failure that is recorded [characters]


class Plan(Protocol):
    """Cases that one folder holds; a process needs the plan only to describe and to store a case, not to compute it."""

    @property
    def files(self) -> Mapping[str, str]:
        """Texts by file name that define the plan; two plans with the same files have the same cases."""
        ...

    def __len__(self) -> int:
        """Number of cases."""
        ...

    def case(self, number: int) -> Mapping[str, Any]:
        """Plain data with everything that the computation of a case needs.

        Raises:
            InputError: The settings of this case are not valid together.
        """
        ...


class CaseOutput(NamedTuple):
    """What the computation of a case returns.

    Attributes:
        result: Plain data for JSON.
        files: Texts of the files to keep, by their path in the folder of the case.
    """

    result: Any
    files: Mapping[str, str] = {}


Compute = Callable[[Mapping[str, Any]], CaseOutput]
"""Computes a case from its data; a function of a module, which other processes can import."""


@dataclass(frozen=True)
class CaseResult:
    """A finished case.

    Attributes:
        result: Plain data; None if the case failed.
        failed: Reason why the case failed; empty if it did not.
        seconds: Time of the computation [s].
        files: Texts of the files to keep, by their path in the folder of the case.
    """

    result: Any = None
    failed: str = ""
    seconds: float = 0.0
    files: Mapping[str, str] = field(default_factory=dict)


def computed(compute: Compute, case: Mapping[str, Any]) -> CaseResult:
    """Computes a case; an error of the case becomes its result.

    Raises:
        OSError: The system failed, such as a full disk: other cases would fail, too.
        MemoryError: There is too little memory.
    """
    begin = perf_counter()
    try:
        result, files = compute(case)
    except (OSError, MemoryError):
        raise
    except Exception as error:
        return CaseResult(failed=reason_of(error), seconds=perf_counter() - begin)
    return CaseResult(result, seconds=perf_counter() - begin, files=files)


def reason_of(error: Exception) -> str:
    """The message of an error as one line, with the error's type if StepGap did not raise it."""
    kind = "" if isinstance(error, StepGapError) else f"{type(error).__name__}: "
    return " ".join(f"{kind}{error}".split())[:LONGEST_REASON]
