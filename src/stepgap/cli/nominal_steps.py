"""Steps of the nominal map for `stepgap gait`: one with its derivatives, many rows of a file, a table of commands."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, write_new

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.step import Array, Quantity, StepMap, StepSpace

DEFAULT_GRID = 15  # Grid points along each axis of a table; it has the fourth power of this many commands


def print_step(nominal: "StepMap", state: list[float], command: list[float]) -> None:
    """Prints the next state of one step and its derivatives."""
    from stepgap.step import StepFailed

    space = nominal.space
    try:
        next_state = nominal(state, command)
    except StepFailed as error:
        point = f"{named_values(space.state, state)}, {named_values(space.command, command)}"
        raise InputError(f"{point}: the step has no next state ({error})") from None
    print(describe_step(space, state, command, next_state, nominal.jacobian(state, command)))


def map_rows(nominal: "StepMap", rows: Path, out: Path | None) -> None:
    """Evaluates the rows of a CSV file."""
    from stepgap.control.points_file import outcome_rows, read_points

    if out:
        check_new(out, "--out")
    try:
        points = read_points(rows, nominal.space)
    except ValueError as error:
        raise InputError(str(error)) from None
    n = len(nominal.space.state)
    text = outcome_rows(nominal.space, points, nominal.evaluate(points[:, :n], points[:, n:]))
    if out is None:
        print(text, end="")
        return
    write_new(out, "--out", text)


def write_table(nominal: "StepMap", points: int, file: Path, quiet: bool) -> None:
    """Computes a table of commands and saves its arrays, which `numpy.load` reads without pickle."""
    import numpy as np

    from stepgap.cli.progress import progress_bar
    from stepgap.control.command_table import build_table

    check_new(file, "--table")
    with progress_bar("commands", quiet) as progress:
        table = build_table(nominal, points, progress)
    if not quiet:
        print(f"{table.reached.size} commands, {table.reached.mean():.0%} of them reach their target")
    content = BytesIO()
    quantities = (*table.space.state, *table.space.command)
    np.savez(
        content,
        names=np.array([quantity.name for quantity in quantities]),
        units=np.array([quantity.unit for quantity in quantities]),
        ranges=np.array([[quantity.lower, quantity.upper] for quantity in quantities]),
        commands=table.commands,
        predicted=table.predicted,
        reached=table.reached,
    )
    write_new(file, "--table", content.getvalue())


def describe_step(
    space: "StepSpace", state: list[float], command: list[float], next_state: "Array", jacobian: "Array"
) -> str:
    """The point, its next state and the Jacobian there as text."""
    heads = [f"by {q.name} [{q.unit}]" for q in (*space.state, *space.command)]
    rows = [f"of next {q.name} [{q.unit}]" for q in space.state]
    first = 3 + max(map(len, rows))
    width = max(18, 2 + max(map(len, heads)))
    lines = [
        f"state         {named_values(space.state, state)}",
        f"command       {named_values(space.command, command)}",
        f"next state    {named_values(space.state, next_state)}",
        "",
        "derivative".ljust(first) + "".join(head.rjust(width) for head in heads),
    ]
    for name, row in zip(rows, jacobian, strict=True):
        lines.append(name.ljust(first) + "".join(f"{value:{width}.6g}" for value in row))
    return "\n".join(lines)


def named_values(quantities: "tuple[Quantity, ...]", values: "Sequence[float] | Array", form: str = ".6f") -> str:
    """Names, values and units, separated by commas."""
    return ", ".join(f"{q.name} {value:{form}} {q.unit}" for q, value in zip(quantities, values, strict=True))
