"""Execution of cases: the options, the progress and the messages that several verbs share."""

import os
import shlex
import sys
from collections.abc import Callable, Iterable
from concurrent.futures import Executor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from stepgap.base.errors import InputError, message_of
from stepgap.base.start_method import usable_cores
from stepgap.cli.options import Address, Flag, Integer
from stepgap.cli.terminal import warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Iterator

    from stepgap.sweep.cases.case_folder import CaseFolder
    from stepgap.sweep.cases.plan import CaseResult, Compute, Plan
    from stepgap.sweep.cases.shard import Shard


@Parameter(name="*")
@dataclass(frozen=True)
class Execution:
    """Where the cases are computed.

    Attributes:
        processes: Number of processes on this machine. [default: one for each core]
        shard: Compute only part I of N of the cases, given as I/N. [default: the part of this task, in a job array of
            SLURM, LSF or Grid Engine; else all]
        dask: Compute on a dask cluster: the address of its scheduler, its scheduler file, or local.
        resume: Continue the cases in --out that are not finished.
        retry_failed: Compute failed cases again, too.
        merge: Folders of the same cases whose results are added, such as those of shards without a common folder;
            nothing is computed.
        quiet: Print only the paths of the results.
    """

    processes: Annotated[Integer | None, Parameter(validator=Number(gte=1, lte=1024))] = None
    shard: Annotated[str, Parameter(metavar="I/N")] | None = None
    dask: Address | None = None
    resume: Flag = False
    retry_failed: Flag = False
    merge: Annotated[tuple[Path, ...], Parameter(consume_multiple=True, show_default=False)] = ()
    quiet: Flag = False


THIS_MACHINE = Execution()

_FAILURES_SHOWN = 5
"""Number of failed cases whose reasons are printed; all are in the table."""


def shard_of(execution: Execution) -> "Shard | None":
    """The given shard, or that of a job array; None for all cases."""
    from stepgap.sweep.cases.shard import parse_shard, shard_of_job_array

    if execution.shard is not None:
        shard = parse_shard(execution.shard)
    else:
        shard = None if execution.dask else shard_of_job_array(os.environ)
        if shard and not execution.quiet:
            warn(f"shard {shard.index}/{shard.count}, from the job array's environment variables")
    if shard and execution.dask:
        raise InputError("--shard, --dask: give only one of them")
    return shard


@contextmanager
def opened(path: Path, plan: "Plan", execution: Execution, shard: "Shard | None") -> "Iterator[CaseFolder]":
    """The folder of a plan, which a shard shares with others; errors of the file system are one line.

    Args:
        path: The folder.
        plan: Describes the cases.
        execution: Its options may allow the folder to hold results already.
        shard: Part of the cases, None for all.
    """
    from stepgap.sweep.cases.case_folder import CaseFolder

    name = next(iter(plan.files))
    for other in execution.merge:
        if not (other / name).is_file():
            raise InputError(f"--merge {other}: contains no {name}, so there are no results to add")
        with CaseFolder(other, plan, join=True):
            pass  # it holds the same cases
    try:
        folder = CaseFolder(path, plan, execution.resume or bool(execution.merge) or shard is not None)
    except OSError as error:
        raise InputError(f"{message_of(error)}; choose another folder") from None
    with folder:
        yield folder


def continuing(command: str, folder: Path, execution: Execution) -> str:
    """The command line that continues an execution."""
    options = {"--processes": execution.processes, "--shard": execution.shard, "--dask": execution.dask}
    given = [word for name, value in options.items() if value is not None for word in (name, str(value))]
    given += ["--merge", *map(str, execution.merge)] if execution.merge else []
    return shlex.join([*command.split(), "--out", str(folder), "--resume", *given])


@contextmanager
def stopping(command: str) -> "Iterator[None]":
    """Adds the command that continues to the message after Ctrl-C, and lets SIGTERM act like it."""
    from stepgap.base.signals import terminated_as_interrupted

    try:
        with terminated_as_interrupted():
            yield
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"; continue with: {command}") from None


def execute_cases(
    plan: "Plan", folder: "CaseFolder", compute: "Compute", execution: Execution, shard: "Shard | None"
) -> None:
    """Computes the cases that have no result yet, and displays the progress; or adds the results of other folders."""
    from stepgap.sweep.cases.execution import execute

    if execution.merge:
        _merge_folders(plan, folder, execution.merge)
        return
    finished, chosen = folder.finished(), shard.numbers(len(plan)) if shard else range(len(plan))
    if execution.retry_failed:
        finished -= {number for number in finished.intersection(chosen) if folder.forget_failure(number)}
    numbers = [number for number in chosen if number not in finished]
    if not numbers:
        return
    progress, executors = _progress(len(numbers), execution.quiet), _executor(execution, len(numbers))
    with progress as on_result, executors as (executor, at_once):
        execute(plan, folder, numbers, compute, executor, at_once, on_result)


def all_finished(plan: "Plan", folder: "CaseFolder", execution: Execution) -> bool:
    """Whether all cases have a result; if not, says how many of them have one."""
    count = len(folder.finished())
    if count < len(plan) and not execution.quiet:
        print(f"{folder.path}: {count} of {len(plan)} cases are finished", file=sys.stderr)
    return count == len(plan)


@contextmanager
def _executor(execution: Execution, cases: int) -> "Iterator[tuple[Executor, int]]":
    """Executor of the cases, and how many it has at the same time; it is stopped at once after an error."""
    from stepgap.sweep.cases.cluster import LARGEST_BACKLOG, dask_executor
    from stepgap.sweep.cases.processes import Processes

    count = min(execution.processes or usable_cores(), cases)
    with ExitStack() as stack:
        if execution.dask:
            executor, at_once = stack.enter_context(dask_executor(execution.dask, count)), LARGEST_BACKLOG
        else:
            executor, at_once = Processes(count), count
        try:
            yield executor, at_once
        except BaseException:
            executor.shutdown(wait=False)
            raise
        executor.shutdown()


@contextmanager
def _progress(cases: int, quiet: bool) -> "Iterator[Callable[[int, CaseResult], None]]":
    """Yields a callback that displays the progress: a bar on a terminal, elsewhere about 20 lines."""
    from time import perf_counter

    from stepgap.cli.progress import progress_bar

    begin, every = perf_counter(), -(-cases // 20)
    done, failed, seconds = 0, 0, 0.0
    with progress_bar("cases", quiet) as bar:

        def on_result(number: int, result: "CaseResult") -> None:
            nonlocal done, failed, seconds
            done, failed, seconds = done + 1, failed + bool(result.failed), seconds + result.seconds
            bar(done, cases)
            if result.failed and failed <= _FAILURES_SHOWN and not quiet:
                warn(f"case {number} failed: {result.failed}")
            if not quiet and not sys.stderr.isatty() and (done % every == 0 or done == cases):
                minutes = (perf_counter() - begin) * (cases - done) / done / 60
                print(f"{done} of {cases} cases, {failed} failed, {minutes:.0f} min remaining", file=sys.stderr)

        yield on_result
    if not quiet:
        print(f"{done} cases computed, {failed} failed, {seconds / max(done, 1):.1f} s each", file=sys.stderr)


def _merge_folders(plan: "Plan", folder: "CaseFolder", others: "Iterable[Path]") -> None:
    """Adds the results of other folders of the same plan."""
    from stepgap.sweep.cases.case_folder import CaseFolder

    for path in others:
        if path.resolve() == folder.path.resolve():
            continue
        with CaseFolder(path, plan, join=True) as other:
            folder.add_results(other)
