"""A table of commands, as `stepgap map --table` computes it: in this process, or as cases."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.output_files import check_new, free_name, writing
from stepgap.cli.execution import Execution, all_finished, execute_cases, opened, shard_of, stopping

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.control.command_table import CommandTable, TableError
    from stepgap.experiment.cases.case_folder import CaseFolder
    from stepgap.experiment.table_plan import TablePlan
    from stepgap.step import Array, Quantity, StepMap


def map_table(plan: "TablePlan", nominal: "StepMap", file: Path, seed: int, execution: Execution) -> None:
    """Computes a table of commands, saves it, and measures the error of interpolation.

    Args:
        plan: Grid and settings of the map.
        nominal: The map.
        file: New file for the table.
        seed: Random seed of the points at which the error is measured.
        execution: Where the table is computed.
    """
    check_new(file, "--table")
    if _needs_no_cases(execution):
        file, table = _solved_here(plan, nominal, file, execution.quiet)
    else:
        table = _solved_as_cases(plan, file, execution)
    if table is not None and not execution.quiet:
        _print_error(table, nominal, seed)
    if file.exists():  # otherwise other shards compute other parts of it
        print(file)


def _needs_no_cases(execution: Execution) -> bool:
    """Whether a table is computed in this process, from beginning to end."""
    elsewhere = execution.shard, execution.dask, execution.resume, execution.retry_failed, execution.merge
    return execution.processes in (None, 1) and not any(elsewhere)


def _solved_here(plan: "TablePlan", nominal: "StepMap", file: Path, quiet: bool) -> "tuple[Path, CommandTable]":
    from stepgap.cli.progress import progress_bar
    from stepgap.control.command_table import build_table
    from stepgap.control.command_table_file import write_table

    with progress_bar("commands", quiet) as progress:
        table = build_table(nominal, plan.points, progress)
    file = free_name(file)  # another process may have used the name in the meantime
    with writing(file, "--table"):
        write_table(file, table)
    return file, table


def _solved_as_cases(plan: "TablePlan", file: Path, execution: Execution) -> "CommandTable | None":
    """Computes the cases in a folder beside the table; returns the table if this process completed it."""
    from stepgap.experiment.table_plan import solve_batch

    folder = file.with_name(f"{file.name}.cases")
    shard = shard_of(execution) if execution.shard else None  # each task of a job array may compute a table of its own
    with (
        opened(folder, plan, execution, shard) as cases,
        stopping("the same command with --resume"),
    ):
        execute_cases(plan, cases, solve_batch, execution, shard)
        with cases.alone():
            if file.exists() and not cases.finished():
                return None  # another process completed the table and removed the cases
            return _completed(plan, cases, file) if all_finished(plan, cases, execution) else None


def _completed(plan: "TablePlan", cases: "CaseFolder", file: Path) -> "CommandTable":
    """Writes the table of the finished cases, and removes their folder."""
    from stepgap.control.command_table_file import write_table
    from stepgap.experiment.table_plan import table_of_cases

    table = table_of_cases(plan, cases)
    check_new(file, "--table")
    with writing(file, "--table"):
        write_table(file, table)
    shutil.rmtree(cases.path, ignore_errors=True)
    return table


def _print_error(table: "CommandTable", nominal: "StepMap", seed: int) -> None:
    import numpy as np

    from stepgap.control.command_table import measure_table

    try:
        print(describe_table(table, measure_table(table, nominal, np.random.default_rng(seed))))
    except ValueError as error:
        print(error)


def describe_table(table: "CommandTable", error: "TableError") -> str:
    """Size of a table and error of interpolation in it, as text."""
    space = table.space
    return "\n".join(
        [
            f"{table.reached.size} commands, {table.reached.mean():.0%} of them reach their target",
            f"interpolated, at {error.samples} random points between nodes with reachable targets:",
            f"  worst error of the command       {named_values(space.command, error.worst_command, '.2g')}",
            f"  worst error of the next state    {named_values(space.state, error.worst_state, '.2g')}",
            f"  median error of the next state   {named_values(space.state, error.median_state, '.2g')}",
            f"at {error.border_samples} points on the border of the reachable targets:",
            f"  worst error of the next state    {named_values(space.state, error.border_state, '.2g')}",
        ]
    )


def named_values(quantities: "tuple[Quantity, ...]", values: "Sequence[float] | Array", form: str = ".6f") -> str:
    """Names, values and units, separated by commas."""
    return ", ".join(f"{q.name} {value:{form}} {q.unit}" for q, value in zip(quantities, values, strict=True))
