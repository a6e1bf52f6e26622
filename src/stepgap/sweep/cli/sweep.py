"""The verb `stepgap sweep`."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError, StepGapError
from stepgap.cli.options import Flag
from stepgap.cli.terminal import announces_compilation, warn
from stepgap.sweep.cli.execution import THIS_MACHINE, Execution, all_finished, computed_cases

if TYPE_CHECKING:  # slow imports are made where they are used
    from collections.abc import Iterator

    from stepgap.sweep.cases.case_folder import CaseFolder
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
    from stepgap.base.output_files import free_name
    from stepgap.experiment.run_start import dated_folder
    from stepgap.sweep.sweep_case import run_case
    from stepgap.sweep.sweep_file import read_sweep

    experiments = read_sweep(_sweep_file(file, out, execution))
    if plan:
        print(describe_plan(experiments))
        return
    if execution.shard and not out:
        raise InputError("--shard: give --out, so that all shards use the same folder")
    folder = out or free_name(dated_folder("sweeps"))
    with computed_cases(folder, experiments, run_case, execution, "stepgap sweep") as cases:
        if all_finished(experiments, cases, execution.quiet) or (cases.finished() and not execution.shard):
            _write_all(experiments, cases, execution.quiet)


def _sweep_file(file: Path | None, out: Path | None, execution: Execution) -> Path:
    """File of the sweep: the given one, or that in a folder which is continued."""
    from stepgap.sweep.sweep import SWEEP_FILE

    if file:
        return file
    if not (execution.resume and out):
        raise InputError("SWEEP.toml: missing; give the file of a sweep, or --resume with the --out of one")
    if not (out / SWEEP_FILE).is_file():
        raise InputError(f"{out}: contains no {SWEEP_FILE}, so there is no sweep to continue")
    return out / SWEEP_FILE


def _write_all(experiments: "Sweep", folder: "CaseFolder", quiet: bool) -> None:
    from stepgap.sweep.report.page import report_sweep

    with folder.alone():
        tables = write_tables(experiments, folder)
        report = report_sweep(folder.path)
    for path in (*tables, report.path):
        print(path)
    if report.missing and not quiet:
        warn(f"missing in the report: {'; '.join(report.missing)}")
    reasons = [result.failed for _, result in folder.results()]
    if all(reasons):
        raise StepGapError(f"{folder.path}: all cases failed, the first one: {reasons[0]}")


def write_tables(experiments: "Sweep", folder: "CaseFolder") -> list[Path]:
    """Writes the table of the finished cases as CSV and, where pyarrow is installed, as Parquet; returns their paths.

    Raises:
        InputError: The result of a case is not valid.
        OSError: A file cannot be read or written.
    """
    from stepgap.base.files import write_whole
    from stepgap.records.parquet_file import parquet_file
    from stepgap.sweep.results_table import RESULTS, columns_of, read_results, table_text

    path = folder.path / RESULTS
    write_whole(path, table_text(columns_of(experiments.names, experiments.space), _rows(experiments, folder)))
    if find_spec("pyarrow") is None:
        path.with_suffix(".parquet").unlink(missing_ok=True)  # one of an earlier table
        return [path]
    write_whole(path.with_suffix(".parquet"), parquet_file(read_results(path).as_columns()))
    return [path, path.with_suffix(".parquet")]


def _rows(experiments: "Sweep", folder: "CaseFolder") -> "Iterator[list[str]]":
    from stepgap.sweep.results_table import rows_of_results

    for number, case in folder.results():
        settings = experiments.settings(number)
        try:
            yield from rows_of_results(number, settings, case.result, case.failed, experiments.space)
        except ValueError as error:
            remedy = "remove this file and continue with --resume"
            raise InputError(f"{folder.result_path(number)}: {error}; {remedy}") from None


def describe_plan(experiments: "Sweep") -> str:
    """Axes and number of cases of a sweep, as text."""
    lines = [f"{len(axis.points):7} × {', '.join(axis.names)}" for axis in experiments.axes]
    return "\n".join([*lines, f"{len(experiments):7} cases"])
