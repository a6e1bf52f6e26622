"""The verb `stepgap gait`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, free_name
from stepgap.cli.nominal_steps import DEFAULT_GRID, map_rows, named_values, print_step, write_table
from stepgap.cli.options import Flag, Integer, NamedValues, Overrides
from stepgap.cli.terminal import announces_compilation, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from matplotlib.figure import Figure

    from stepgap.step import StepMap


@announces_compilation
def gait(
    experiment: Path | None = None,
    /,
    *,
    state: NamedValues | None = None,
    command: NamedValues | None = None,
    csv: Path | None = None,
    table: Path | None = None,
    points: Annotated[Integer | None, Parameter(validator=Number(gte=2, lte=50))] = None,
    out: Path | None = None,
    quiet: Flag = False,
    overrides: Overrides = None,
) -> None:
    """Look at the nominal map: the limit cycle at a state, and the set that one step from it can reach; or its steps.

    Args:
        experiment: TOML file of settings.
        state: State in SI units, such as speed=0.2,height=0.58. [default: the middle of the ranges of use]
        command: Command of one step, such as fx=5,fy=-5: its next state and derivatives, instead of a limit cycle.
        csv: File with a column for each coordinate of state and command: the next states of its rows instead.
        table: New file (.npz, of NumPy) for a table of the step controller's commands instead.
        points: Grid points along each axis of the table, 2 to 50. [default: 15]
        out: New file for the figure or, with --csv, for the next states. [default: gait.png or the next free name; next
            states are printed]
        quiet: Print only the path of the table.
    """
    from stepgap.experiment.nominal import load_nominal
    from stepgap.experiment.settings import read_experiment
    from stepgap.records.text import values_by_name

    modes = {"--csv": csv, "--table": table, "--command": command}
    chosen = [name for name, value in modes.items() if value is not None]
    if state is not None and (csv or table):
        chosen.append("--state")
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)}: give only one of them")
    if out and (table or command is not None):
        raise InputError("--out: valid only for the figure, and with --csv")
    if points is not None and not table:
        raise InputError(f"--points {points}: valid only with --table")
    if quiet and not table:
        raise InputError("--quiet: valid only with --table")
    if out:
        check_new(out, "--out")
    nominal, _, warnings = load_nominal(read_experiment(experiment, overrides or []))
    for sentence in warnings:
        warn(sentence)
    space = nominal.space
    start = values_by_name("--state", state, space.state, space.state_centre)
    if csv:
        map_rows(nominal, csv, out)
    elif table:
        write_table(nominal, points or DEFAULT_GRID, table, quiet)
    elif command is not None:
        print_step(nominal, start, values_by_name("--command", command, space.command, space.command_centre))
    else:
        _draw_gait(nominal, start, out)


def _draw_gait(nominal: "StepMap", wanted: list[float], out: Path | None) -> None:
    """Prints and draws the limit cycle at a state, and the set that one step can reach."""
    from stepgap.control.limit_cycle import fixed_point, reachable_set
    from stepgap.report.drawing import write_picture
    from stepgap.step import StepFailed

    try:
        point = fixed_point(nominal, wanted)
    except StepFailed as error:
        where = named_values(nominal.space.state, wanted)
        raise InputError(f"{where}: no command makes a step from this state ({error})") from None
    reachable = reachable_set(nominal, point.state)

    def described_figure() -> "Figure":
        from stepgap.report.gait import describe_gait, gait_figure

        print(describe_gait(nominal, point, reachable))
        return gait_figure(nominal.space, point, reachable)

    write_picture(out or free_name(Path("gait.png")), described_figure)
