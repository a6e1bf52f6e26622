"""The verb `stepgap gait`."""

from math import isfinite
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.output_files import free_name, writing
from stepgap.cli.options import Overrides
from stepgap.cli.terminal import announces_compilation


@announces_compilation
def gait(
    experiment: Path | None = None,
    /,
    *,
    speed: float = 0.2,
    height: float = 0.58,
    out: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Find the limit cycle of the nominal map at a speed and height, and the set that one step from it can reach.

    Args:
        experiment: TOML file of settings.
        speed: Forward speed at the apex [m/s].
        height: Height of the apex [m].
        out: New file for the figure. [default: gait.png or the next free name]
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
            f"--speed {speed:g} --height {height:g}: no command makes a step from this state ({error})"
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
