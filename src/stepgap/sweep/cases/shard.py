"""Shards: the cases of one task of a job array."""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from stepgap.base.errors import InputError


@dataclass(frozen=True)
class Shard:
    """One of several parts of a plan with almost equally many cases.

    Attributes:
        index: Number of the part, from 1.
        count: Number of parts.
    """

    index: int = 1
    count: int = 1

    def numbers(self, cases: int) -> range:
        """Numbers of the cases in this part, of a plan with this number of cases."""
        return range(self.index - 1, cases, self.count)


class _Variables(NamedTuple):
    """Environment variables of a task of a job array: its number, the first and last ones, their interval and count."""

    number: str
    first: str = ""
    last: str = ""
    interval: str = ""
    tasks: str = ""


_SLURM = (f"SLURM_ARRAY_TASK_{name}" for name in ("ID", "MIN", "MAX", "STEP", "COUNT"))
_SCHEDULERS = (
    _Variables(*_SLURM),
    _Variables("LSB_JOBINDEX", last="LSB_JOBINDEX_END", interval="LSB_JOBINDEX_STEP"),
    _Variables("SGE_TASK_ID", "SGE_TASK_FIRST", "SGE_TASK_LAST", "SGE_TASK_STEPSIZE"),
    _Variables("PBS_ARRAY_INDEX"),
    _Variables("PBS_ARRAYID"),
)
"""Job arrays of SLURM, LSF, Grid Engine, PBS Pro and TORQUE; PBS does not give the last number."""


def parse_shard(text: str) -> Shard:
    """The shard of a text `I/N`.

    Raises:
        InputError: The text is not I/N with 1 ≤ I ≤ N.
    """
    match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", text)
    if not match or not 1 <= int(match[1]) <= int(match[2]):
        raise InputError(f"--shard {text:.40}: must be I/N, such as 1/3 for the first of three parts")
    return Shard(int(match[1]), int(match[2]))


def shard_of_job_array(environment: Mapping[str, str]) -> Shard | None:
    """The shard of this task of a job array of SLURM, LSF, Grid Engine or PBS; None outside a job array.

    Args:
        environment: Environment variables.

    Raises:
        InputError: The scheduler does not give the number of tasks.
    """
    for names in _SCHEDULERS:
        number = environment.get(names.number, "")
        if not number.isdecimal() or (names.number == "LSB_JOBINDEX" and number == "0"):
            continue
        if not environment.get(names.last, "").isdecimal():
            raise InputError(
                f"--shard: {names.number} is set, but not the number of tasks; give --shard ${names.number}/N"
            )
        first, interval = int(environment.get(names.first) or 1), int(environment.get(names.interval) or 1)
        count = (int(environment[names.last]) - first) // interval + 1
        if int(environment.get(names.tasks) or count) != count:
            raise InputError(f"--shard: the numbers of this job array have gaps; give --shard ${names.number}/N")
        return Shard((int(number) - first) // interval + 1, count)
    return None
