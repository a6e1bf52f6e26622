"""The verb `stepgap sweep`."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError, StepGapError
from stepgap.cli.options import Flag
from stepgap.cli.terminal import announces_compilation, warn
from stepgap.sweep.cli.execution import (
    THIS_MACHINE,
    Execution,
    all_finished,
    continuing,
    execute_cases,
    opened,
    shard_of,
    stopping,
)

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.sweep.cases.case_folder import CaseFolder
    from stepgap.sweep.cases.shard import Shard
    from stepgap.sweep.sweep import Sweep


@announces_compilation
def sweep(
    file: Path | None = None,
    /,
    *,
    out: Path | None = None,
    execution: Execution = THIS_MACHINE,
    plan: Flag = False,
) -> None:
    """Run many experiments whose settings differ along axes: a parameter sweep, with a table and a report of all.

    Args:
        file: TOML file of the sweep, as docs/sweep.md describes it. [default: with --resume, the sweep in --out]
        out: Folder for the results. [default: a new one in sweeps/]
        plan: Check the sweep and print the number of cases, but run none.
    """
    from stepgap.sweep.sweep_case import run_case
    from stepgap.sweep.sweep_file import read_sweep

    path = _sweep_file(file, out, execution)
    found = read_sweep(path)
    if plan:
        print(describe_plan(found))
        return
    shard = shard_of(execution)
    folder = out or _new_folder(shard)
    command = continuing("stepgap sweep", folder, execution)
    with opened(folder, found, execution, shard) as cases, stopping(command):
        execute_cases(found, cases, run_case, execution, shard)
        if all_finished(found, cases, execution) or (cases.finished() and not shard):
            _write_all(found, cases, execution.quiet)


def _sweep_file(file: Path | None, out: Path | None, execution: Execution) -> Path:
    """File of the sweep: the given one, or that in a folder which is continued."""
    from stepgap.sweep.sweep import SWEEP_FILE

    if file:
        return file
    folder = out if execution.resume else execution.merge[0] if execution.merge else None
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


def _write_all(found: "Sweep", folder: "CaseFolder", quiet: bool) -> None:
    """Writes the tables and the report of the finished cases, and prints their paths."""
    from stepgap.sweep.cli.sweep_report import report_sweep

    tables = write_tables(found, folder)
    with folder.alone():
        report = report_sweep(folder.path)
    for path in (*tables, report.path):
        print(path)
    if report.missing and not quiet:
        warn(f"missing in the report: {'; '.join(report.missing)}")
    _, first = next(folder.results())
    if all(found.failed for _, found in folder.results()):
        raise StepGapError(f"{folder.path}: all cases failed, the first one: {first.failed}")


def write_tables(found: "Sweep", folder: "CaseFolder") -> "list[Path]":
    """Writes the table of a sweep as CSV and, where pyarrow is installed, as Parquet."""
    from stepgap.base.files import write_whole
    from stepgap.records.parquet_file import parquet_file
    from stepgap.sweep.results import write_results
    from stepgap.sweep.results_table import read_results

    path = write_results(found, folder)
    if find_spec("pyarrow") is None:
        path.with_suffix(".parquet").unlink(missing_ok=True)  # one of an earlier table
        return [path]
    content = parquet_file(read_results(path).as_columns())
    with folder.alone():
        write_whole(path.with_suffix(".parquet"), content)
    return [path, path.with_suffix(".parquet")]


def describe_plan(found: "Sweep") -> str:
    """Axes and number of cases of a sweep, as text."""
    lines = [f"{len(axis.points):7} × {', '.join(axis.names)}" for axis in found.axes]
    return "\n".join([*lines, f"{len(found):7} cases"])
