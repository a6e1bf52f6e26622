"""The verbs that ask the model: its gaits, its map."""

import re
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, free_name, writing
from stepgap.cli.app import Overrides, says_if_it_compiles

if TYPE_CHECKING:
    from stepgap.step import StepMap

POINT = {"speed": 0.2, "height": 0.58, "fx": 0.0, "fy": 0.0}
"""The step that `map` takes if none is given, SI units."""
MOST_POINTS = 50
"""A table has the fourth power of this many commands."""


@says_if_it_compiles
def gait(
    experiment: Path | None = None,
    /,
    *,
    speed: float = 0.2,
    height: float = 0.58,
    out: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Find the limit cycle of the nominal map at a speed and height, and what one step can reach from it.

    Args:
        experiment: TOML file of settings.
        speed: Forward speed at the apex [m/s]; without it 0.2.
        height: Height of the apex [m]; without it 0.58.
        out: Picture to save; without it gait.png or the next free name.
    """
    from stepgap.control.limit_cycle import fixed_point, reachable_set
    from stepgap.experiment.settings import read_experiment
    from stepgap.report.gait import describe_gait, gait_figure
    from stepgap.robots.hopper.apex_map import ApexMap
    from stepgap.step import StepFailed

    if not (isfinite(speed) and isfinite(height)):
        raise InputError(f"--speed {speed} --height {height}: both must be finite numbers")
    settings = read_experiment(experiment, overrides or [])
    if out and out.exists():
        raise InputError(f"{out}: exists already; choose another --out")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    try:
        point = fixed_point(nominal, [speed, height])
    except StepFailed as error:
        raise InputError(
            f"--speed {speed:g} --height {height:g}: no command makes a step from there ({error})"
        ) from None
    reachable = reachable_set(nominal, point.state)
    figure = gait_figure(nominal.space, point, reachable)
    picture = out or free_name(Path("gait.png"))
    formats = figure.canvas.get_supported_filetypes()
    if picture.suffix[1:].lower() not in formats:
        raise InputError(f"{picture}: the name must end with one of .{', .'.join(formats)}")
    with writing(picture, "--out"):
        figure.savefig(picture, dpi=150)
    print(describe_gait(nominal.space, point, reachable))
    print(picture)


@says_if_it_compiles
def map_(
    experiment: Path | None = None,
    /,
    *,
    speed: float | None = None,
    height: float | None = None,
    fx: float | None = None,
    fy: float | None = None,
    csv: Path | None = None,
    out: Path | None = None,
    table: Path | None = None,
    points: str | None = None,
    tick: float | None = None,
    overrides: Overrides = None,
) -> None:
    """Evaluate the nominal map: the next apex and its derivatives, many rows of a file, or a table of commands.

    Args:
        experiment: TOML file of settings.
        speed: Forward speed at the apex [m/s]; without it 0.2.
        height: Height of the apex [m]; without it 0.58.
        fx: Forward command force [N]; without it 0.
        fy: Upward command force [N]; without it 0.
        csv: File with the columns speed, height, fx, fy; evaluate all its rows.
        out: File for their next apexes; without it they are printed.
        table: File for a table of the step controller's commands, to be built and measured.
        points: Grid points along each axis of the table, a whole number; without it 15.
        tick: Time for which torques are held, as on a robot [s], such as 0.001; without it they act continuously.
    """
    from stepgap.experiment.settings import read_experiment
    from stepgap.robots.hopper.apex_map import ApexMap
    from stepgap.robots.hopper.sampled_map import SampledApexMap

    single = {"speed": speed, "height": height, "fx": fx, "fy": fy}
    ways = {
        "--csv": csv is not None,
        "--table": table is not None,
        "--speed, --height, --fx, --fy": any(value is not None for value in single.values()),
    }
    if sum(ways.values()) > 1:
        raise InputError(f"{' and '.join(name for name, given in ways.items() if given)}: give only one of them")
    if out and not csv:
        raise InputError("--out: goes with --csv; one point is printed")
    count = 15 if points is None else int(points) if re.fullmatch("[0-9]{1,3}", points) else 0
    if points is not None and (not table or not 2 <= count <= MOST_POINTS):
        raise InputError(f"--points {points}: goes with --table, a whole number between 2 and {MOST_POINTS}")
    settings = read_experiment(experiment, overrides or [])
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    if tick is not None:
        try:
            nominal = SampledApexMap(settings.robot, settings.gains, settings.command, tick)
        except ValueError as error:
            raise InputError(f"--tick: {error}") from None
    if csv:
        _map_rows(nominal, csv, out)
    elif table:
        _map_table(nominal, table, count, settings.seed)
    else:
        _map_point(nominal, {name: POINT[name] if value is None else value for name, value in single.items()})


def _map_point(nominal: "StepMap", point: dict[str, float]) -> None:
    """Prints the next apex of one step and its derivatives."""
    from stepgap.cli.map_points import describe_step
    from stepgap.step import StepFailed

    given = " ".join(f"--{name} {value:g}" for name, value in point.items())
    if not all(map(isfinite, point.values())):
        raise InputError(f"{given}: all must be finite numbers")
    state, command = [point["speed"], point["height"]], [point["fx"], point["fy"]]
    try:
        next_state = nominal(state, command)
    except StepFailed as error:
        raise InputError(f"{given}: no step ends in an apex from there ({error})") from None
    print(describe_step(nominal.space, next_state, nominal.jacobian(state, command)))


def _map_rows(nominal: "StepMap", rows: Path, out: Path | None) -> None:
    """Evaluates the rows of a CSV file."""
    from stepgap.cli.map_points import outcome_rows, read_points

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
    with writing(out, "--out"), out.open("x", encoding="utf-8") as file:
        file.write(text)
    print(out)


def _map_table(nominal: "StepMap", file: Path, points: int, seed: int) -> None:
    """Builds a table of commands, measures what interpolation costs, and saves it."""
    import numpy as np

    from stepgap.cli.map_points import describe_table
    from stepgap.cli.progress import shown_count
    from stepgap.control.command_table import build_table, measure_table
    from stepgap.control.command_table_file import write_table

    check_new(file, "--table")
    with shown_count("commands") as tell:
        table = build_table(nominal, points, tell)
    file = free_name(file)  # another process may have taken the name by now
    with writing(file, "--table"):
        write_table(file, table)
    try:
        print(describe_table(table, measure_table(table, nominal, np.random.default_rng(seed))))
    except ValueError as error:
        print(error)
    print(file)
