"""Execution of cases: the options, the progress and the messages that several commands share."""

import os
import re
import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from stepgap.base.errors import InputError, message_of
from stepgap.base.signals import terminated_as_interrupted
from stepgap.base.start_method import usable_cores
from stepgap.cli.options import Address, Flag, Integer
from stepgap.cli.terminal import is_watched, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from concurrent.futures import Executor

    from stepgap.sweep.cases.case_folder import CaseFolder
    from stepgap.sweep.cases.plan import CaseResult, Compute, Plan

JOB_ARRAYS = ("SLURM_ARRAY_TASK_ID", "LSB_JOBINDEX", "SGE_TASK_ID", "PBS_ARRAY_INDEX", "PBS_ARRAYID")
"""Environment variables with the number of a task of a job array, of SLURM, LSF, Grid Engine, PBS Pro and TORQUE."""

_FAILURES_SHOWN = 5  # Number of failed cases whose reasons are printed; all are in the table


@Parameter(name="*")
@dataclass(frozen=True)
class Execution:
    """Where the cases are computed.

    Attributes:
        processes: Number of processes on this machine. [default: one for each core]
        shard: Compute only part I of N of the cases, given as I/N, such as one task of a job array.
        dask: Compute on a dask cluster: the address of its scheduler, its scheduler file, or local.
        resume: Continue the cases in --out that are not finished.
        retry_failed: Compute failed cases again, too.
        quiet: Print only the paths of the results.
    """

    processes: Annotated[Integer | None, Parameter(validator=Number(gte=1, lte=1024))] = None
    shard: Annotated[str, Parameter(metavar="I/N")] | None = None
    dask: Address | None = None
    resume: Flag = False
    retry_failed: Flag = False
    quiet: Flag = False

    def numbers(self, cases: int) -> range:
        """Numbers of the cases to compute, of a plan with this number of cases.

        Raises:
            InputError: The options contradict each other, or the shard is not I/N with 1 ≤ I ≤ N.
        """
        if self.shard is None:
            task = next((name for name in JOB_ARRAYS if os.environ.get(name, "0") not in ("0", "undefined")), None)
            if task and not self.dask:
                raise InputError(f"--shard: {task} is set, so this is a task of a job array; give --shard ${task}/N")
            return range(cases)
        if self.dask:
            raise InputError("--shard, --dask: give only one of them")
        match = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", self.shard)
        if not match or not 1 <= int(match[1]) <= int(match[2]):
            raise InputError(f"--shard {self.shard:.40}: must be I/N, such as 1/3 for the first of three parts")
        return range(int(match[1]) - 1, cases, int(match[2]))


THIS_MACHINE = Execution()


@contextmanager
def computed_cases(
    path: Path, plan: "Plan", compute: "Compute", execution: Execution, command: str
) -> "Iterator[CaseFolder]":
    """Computes the cases of a plan that have no result yet, and displays the progress; yields their folder.

    Args:
        path: The folder.
        plan: Describes the cases.
        compute: Computes a case.
        execution: Options.
        command: The command, without its options, that continues after Ctrl-C or a signal.
    """
    from stepgap.sweep.cases.case_folder import CaseFolder
    from stepgap.sweep.cases.execution import execute

    chosen = execution.numbers(len(plan))
    try:
        folder = CaseFolder(path, plan, execution.resume or execution.shard is not None)
    except OSError as error:
        raise InputError(f"{message_of(error)}; choose another folder") from None
    finished = folder.finished()
    if execution.retry_failed:
        finished -= {number for number in finished.intersection(chosen) if folder.read(number).failed}
    numbers = [number for number in chosen if number not in finished]
    try:
        with terminated_as_interrupted():
            if numbers:
                with _progress(len(numbers), execution.quiet) as on_result, _executor(execution, len(numbers)) as place:
                    execute(plan, folder, numbers, compute, *place, on_result)
            yield folder
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"; continue with: {_continuing(command, path, execution)}") from None


def _continuing(command: str, folder: Path, execution: Execution) -> str:
    """The command line that continues an execution."""
    options = {"--processes": execution.processes, "--shard": execution.shard, "--dask": execution.dask}
    given = [word for name, value in options.items() if value is not None for word in (name, str(value))]
    return shlex.join([*command.split(), "--out", str(folder), "--resume", *given])


def all_finished(plan: "Plan", folder: "CaseFolder", quiet: bool) -> bool:
    """Whether all cases have a result; if not, says how many of them have one."""
    count = len(folder.finished())
    if count < len(plan) and not quiet:
        print(f"{folder.path}: {count} of {len(plan)} cases are finished", file=sys.stderr)
    return count == len(plan)


@contextmanager
def _executor(execution: Execution, cases: int) -> "Iterator[tuple[Executor, int]]":
    """Executor of the cases, and how many it has at the same time; it is stopped at once after an error."""
    from stepgap.sweep.cases import execution as places

    count = min(execution.processes or usable_cores(), cases)
    if execution.dask:
        with places.dask_executor(execution.dask, count) as executor:
            yield executor, places.LARGEST_BACKLOG
        return
    executor = places.Processes(count)
    try:
        yield executor, count
    except BaseException:
        executor.shutdown(wait=False)
        raise
    executor.shutdown()


@contextmanager
def _progress(cases: int, quiet: bool) -> "Iterator[Callable[[int, CaseResult], None]]":
    """Yields a callback that displays the progress: a bar on a terminal, elsewhere about 20 lines."""
    from stepgap.cli.progress import progress_bar

    begin = perf_counter()
    lines_every = -(-cases // 20)
    done = failed = 0
    seconds = 0.0
    with progress_bar("cases", quiet) as bar:

        def on_result(number: int, result: "CaseResult") -> None:
            nonlocal done, failed, seconds
            done += 1
            failed += bool(result.failed)
            seconds += result.seconds
            bar(done, cases)
            if quiet:
                return
            if result.failed and failed <= _FAILURES_SHOWN:
                warn(f"case {number} failed: {result.failed}")
            if not is_watched(sys.stderr) and (done % lines_every == 0 or done == cases):
                minutes = (perf_counter() - begin) * (cases - done) / done / 60
                print(f"{done} of {cases} cases, {failed} failed, {minutes:.0f} min remaining", file=sys.stderr)

        yield on_result
    if not quiet:
        print(f"{done} cases computed, {failed} failed, {seconds / max(done, 1):.1f} s each", file=sys.stderr)
