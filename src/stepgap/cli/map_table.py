"""A table of commands, as `stepgap map --table` computes it."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.output_files import check_new, free_name, writing

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.control.command_table import CommandTable, TableError
    from stepgap.step import Array, Quantity, StepMap


def map_table(nominal: "StepMap", points: int, file: Path, seed: int, quiet: bool) -> None:
    """Computes a table of commands, saves it, and prints the error of interpolation.

    Args:
        nominal: The map.
        points: Points along each axis of the grid.
        file: New file for the table.
        seed: Random seed of the points at which the error is measured.
        quiet: Print only the path of the table.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.control.command_table import build_table
    from stepgap.control.command_table_file import write_table

    check_new(file, "--table")
    with progress_bar("commands", quiet) as progress:
        table = build_table(nominal, points, progress)
    file = free_name(file)  # another process may have used the name in the meantime
    with writing(file, "--table"):
        write_table(file, table)
    if not quiet:
        _print_error(table, nominal, seed)
    print(file)


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
