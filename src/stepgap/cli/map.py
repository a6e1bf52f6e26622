"""The verb `stepgap map`."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, write_new
from stepgap.cli.options import Flag, Integer, NamedValues, Overrides
from stepgap.cli.terminal import announces_compilation

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.step import Array, Quantity, StepMap, StepSpace

DEFAULT_GRID = 15  # Grid points along each axis of a table; it has the fourth power of this many commands


@announces_compilation
def map_(
    experiment: Path | None = None,
    /,
    *,
    state: NamedValues | None = None,
    command: NamedValues | None = None,
    csv: Path | None = None,
    out: Path | None = None,
    table: Path | None = None,
    points: Annotated[Integer | None, Parameter(validator=Number(gte=2, lte=50))] = None,
    quiet: Flag = False,
    overrides: Overrides = None,
) -> None:
    """Evaluate the nominal map: the next state and its derivatives, many rows of a file, or a table of commands.

    Args:
        experiment: TOML file of settings.
        state: State in SI units, such as speed=0.2,height=0.58. [default: the middle of the ranges of use]
        command: Command in SI units, such as fx=5,fy=-5. [default: the middle of the bounds]
        csv: File with a column for each of them; all its rows are evaluated.
        out: New file for their next states. [default: they are printed]
        table: New file (.npz, of NumPy) for a table of the step controller's commands.
        points: Grid points along each axis of the table, 2 to 50. [default: 15]
        quiet: Print only the path of the table.
    """
    from stepgap.experiment.nominal import load_nominal
    from stepgap.experiment.settings import read_experiment
    from stepgap.records.text import values_by_name

    modes = {"--csv": csv, "--table": table, "--state, --command": state or command}
    chosen = [name for name, value in modes.items() if value is not None]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)}: give only one of them")
    if out and not csv:
        raise InputError("--out: valid only with --csv; the result of one point is printed")
    if points is not None and not table:
        raise InputError(f"--points {points}: valid only with --table")
    if quiet and not table:
        raise InputError("--quiet: valid only with --table")
    nominal = load_nominal(read_experiment(experiment, overrides or [])).map
    if csv:
        _map_rows(nominal, csv, out)
    elif table:
        _map_table(nominal, points or DEFAULT_GRID, table, quiet)
    else:
        space = nominal.space
        start = values_by_name("--state", state, space.state, space.state_centre)
        _map_point(nominal, start, values_by_name("--command", command, space.command, space.command_centre))


def _map_point(nominal: "StepMap", state: list[float], command: list[float]) -> None:
    """Prints the next state of one step and its derivatives."""
    from stepgap.step import StepFailed

    space = nominal.space
    try:
        next_state = nominal(state, command)
    except StepFailed as error:
        point = f"{named_values(space.state, state)}, {named_values(space.command, command)}"
        raise InputError(f"{point}: the step has no next state ({error})") from None
    print(describe_step(space, state, command, next_state, nominal.jacobian(state, command)))


def _map_rows(nominal: "StepMap", rows: Path, out: Path | None) -> None:
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


def _map_table(nominal: "StepMap", points: int, file: Path, quiet: bool) -> None:
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
