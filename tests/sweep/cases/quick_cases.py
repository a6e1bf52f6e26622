"""Plans whose cases take no time, and functions that compute them in other processes."""

import os
import signal
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stepgap.base.errors import InputError
from stepgap.sweep.cases.plan import CaseOutput


@dataclass(frozen=True)
class Squares:
    """Cases that square their numbers; `bad` is the number of one that cannot be described."""

    count: int
    bad: int = -1
    name: str = "squares"

    @property
    def files(self) -> Mapping[str, str]:
        return {"plan.toml": f'name = "{self.name}"\ncount = {self.count}\n', "notes.txt": "αβγ\n"}

    def __len__(self) -> int:
        return self.count

    def case(self, number: int) -> dict[str, int]:
        if number == self.bad:
            raise InputError(f"case {number}: bad")
        return {"number": number}


def square(case: Mapping[str, Any]) -> CaseOutput:
    return CaseOutput(case["number"] ** 2, {"deep/kept.txt": f"{case['number']}\n"})


def fail_at_one(case: Mapping[str, Any]) -> CaseOutput:
    if case["number"] == 1:
        raise ZeroDivisionError("one\nis bad")
    return square(case)


def end_at_one(case: Mapping[str, Any]) -> CaseOutput:
    """Ends its process in case 1, as a crash of compiled code would."""
    if case["number"] == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    return square(case)


def full_disk(case: Mapping[str, Any]) -> CaseOutput:
    raise OSError(28, "No space left on device", "/tmp/x")


def square_of_caller(number: int) -> tuple[int, int]:
    return number**2, os.getpid()


def sleep_after(mark: Path) -> None:
    mark.write_text(str(os.getpid()))
    signal.pause()
