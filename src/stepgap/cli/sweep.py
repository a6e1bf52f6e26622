"""The verb `stepgap sweep`."""

import os
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
from stepgap.cli.options import Flag, Integer
from stepgap.cli.terminal import announces_compilation, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Iterator

    from stepgap.experiment.cases.case_folder import CaseFolder
    from stepgap.experiment.cases.plan import CaseResult, Compute, Plan
    from stepgap.experiment.cases.shard import Shard
    from stepgap.experiment.sweep.sweep import Sweep


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
        quiet: Print only the paths of the results.
    """

    processes: Annotated[Integer | None, Parameter(validator=Number(gte=1, lte=1024))] = None
    shard: str | None = None
    dask: str | None = None
    resume: Flag = False
    retry_failed: Flag = False
    quiet: Flag = False


HERE = Execution()


@announces_compilation
def sweep(
    file: Path | None = None,
    /,
    *,
    out: Path | None = None,
    execution: Execution = HERE,
    merge: Annotated[list[Path] | None, Parameter(consume_multiple=True)] = None,
    plan: Flag = False,
) -> None:
    """Run many experiments whose settings differ along axes: a parameter sweep, with a table and a report of all.

    Args:
        file: TOML file of the sweep, as docs/sweep.md describes it. [default: with --resume, the sweep in --out]
        out: Folder for the results. [default: a new one in sweeps/]
        merge: Folders of the same sweep whose results are added, such as those of shards without a common folder.
        plan: Check the sweep and print the number of cases, but run none.
    """
    from stepgap.experiment.sweep.sweep_case import run_case
    from stepgap.experiment.sweep.sweep_file import read_sweep

    path = _sweep_file(file, out, execution, merge)
    found = read_sweep(path)
    if plan:
        print(describe_plan(found))
        return
    shard = shard_of(execution)
    folder = out or _new_folder(shard)
    join = execution.resume or merge is not None or shard is not None
    with opened(folder, found, join) as cases, stopping(f"stepgap sweep --out {folder} --resume"):
        if merge:
            _merge(found, cases, merge)
        else:
            execute_cases(found, cases, run_case, execution, shard)
        _finish(found, cases, shard, execution.quiet)


def _sweep_file(file: Path | None, out: Path | None, execution: Execution, merge: list[Path] | None) -> Path:
    """File of the sweep: the given one, or that in a folder which is continued."""
    from stepgap.experiment.sweep.sweep import SWEEP_FILE

    if file:
        return file
    folder = out if execution.resume else merge[0] if merge else None
    if folder is None:
        raise InputError("SWEEP.toml: missing; give the file of a sweep, or --resume with the --out of one")
    if not (folder / SWEEP_FILE).is_file():
        raise InputError(f"{folder}: contains no {SWEEP_FILE}, so there is no sweep to continue")
    return folder / SWEEP_FILE


def _new_folder(shard: "Shard | None") -> Path:
    from stepgap.base.output_files import free_name
    from stepgap.experiment.run_start import dated_folder

    if shard:
        raise InputError("--shard: give --out, so that all shards use the same folder")
    return free_name(dated_folder("sweeps"))


def shard_of(execution: Execution) -> "Shard | None":
    """The given shard, or that of a job array; None for all cases."""
    from stepgap.experiment.cases.shard import parse_shard, shard_of_job_array

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
def opened(path: Path, plan: "Plan", join: bool) -> "Iterator[CaseFolder]":
    """The folder of a plan; errors of the file system are one line."""
    from stepgap.experiment.cases.case_folder import CaseFolder

    try:
        folder = CaseFolder(path, plan, join)
    except OSError as error:
        raise InputError(f"{message_of(error)}; choose another --out") from None
    with folder:
        yield folder


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
    """Computes the cases that have no result yet, and displays the progress."""
    from stepgap.experiment.cases.execution import execute

    finished = folder.finished()
    if execution.retry_failed:
        for number, found in folder.results():
            if found.failed:
                folder.forget(number)
                finished.discard(number)
    numbers = [number for number in (shard.numbers(len(plan)) if shard else range(len(plan))) if number not in finished]
    if not numbers:
        return
    with (
        _progress(len(numbers), execution.quiet) as on_result,
        _executor(execution, len(numbers)) as (executor, at_once),
    ):
        execute(plan, folder, numbers, compute, executor, at_once, on_result)


@contextmanager
def _executor(execution: Execution, cases: int) -> "Iterator[tuple[Executor, int]]":
    """Executor of the cases, and how many it has at the same time; it is stopped at once after an error."""
    from stepgap.experiment.cases.cluster import LARGEST_BACKLOG, dask_executor
    from stepgap.experiment.cases.processes import Processes

    count = min(execution.processes or len(os.sched_getaffinity(0)), cases)
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
    done = failed = 0
    with progress_bar("cases", quiet) as bar:

        def on_result(number: int, result: "CaseResult") -> None:
            nonlocal done, failed
            done, failed = done + 1, failed + bool(result.failed)
            bar(done, cases)
            if result.failed and not quiet:
                warn(f"case {number} failed: {result.failed}")
            if not quiet and not sys.stderr.isatty() and (done % every == 0 or done == cases):
                minutes = (perf_counter() - begin) * (cases - done) / done / 60
                print(f"{done} of {cases} cases, {failed} failed, {minutes:.0f} min remaining", file=sys.stderr)

        yield on_result


def _merge(found: "Sweep", folder: "CaseFolder", others: "Iterable[Path]") -> None:
    """Adds the results of other folders of the same sweep."""
    from stepgap.experiment.cases.case_folder import CaseFolder
    from stepgap.experiment.sweep.results import merge_results

    for path in others:
        if path.resolve() == folder.path.resolve():
            continue
        if not (path / next(iter(found.files))).is_file():
            raise InputError(f"--merge {path}: not the folder of a sweep")
        try:
            with CaseFolder(path, found, join=True) as other:
                merge_results(folder, [other])
        except OSError as error:
            raise InputError(f"--merge {path}: {message_of(error)}") from None


def _finish(found: "Sweep", folder: "CaseFolder", shard: "Shard | None", quiet: bool) -> None:
    """Writes table and report, and prints their paths; a shard leaves this to the last one."""
    count = len(folder.finished())
    if shard and count < len(found):
        if not quiet:
            print(f"{folder.path}: {count} of {len(found)} cases are finished", file=sys.stderr)
        return
    if count:
        for path in write_tables(found, folder):
            print(path)


def write_tables(found: "Sweep", folder: "CaseFolder") -> "list[Path]":
    """Writes the table of a sweep as CSV and, where pyarrow is installed, as Parquet."""
    from stepgap.base.files import write_whole
    from stepgap.experiment.sweep.results import write_results
    from stepgap.records.export.parquet import parquet_file
    from stepgap.records.results_table import read_results

    path = write_results(found, folder)
    try:
        content = parquet_file(read_results(path).as_columns())
    except InputError:
        return [path]
    with folder.alone():
        write_whole(path.with_suffix(".parquet"), content)
    return [path, path.with_suffix(".parquet")]


def describe_plan(found: "Sweep") -> str:
    """Axes and number of cases of a sweep, as text."""
    lines = [f"{len(axis.points):7} points of {', '.join(axis.names)}" for axis in found.axes]
    return "\n".join([*lines, f"{len(found):7} cases"])
