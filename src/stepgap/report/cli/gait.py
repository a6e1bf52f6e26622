"""The verb `stepgap gait`."""

from io import BytesIO
from pathlib import Path

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, format_by_name, free_name, write_new
from stepgap.cli.map import named_values
from stepgap.cli.options import NamedValues, Overrides
from stepgap.cli.terminal import announces_compilation, warn


@announces_compilation
def gait(
    experiment: Path | None = None,
    /,
    *,
    state: NamedValues | None = None,
    out: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Find the limit cycle of the nominal map at a state, and the set that one step from it can reach.

    Args:
        experiment: TOML file of settings.
        state: State at the end of the step in SI units, such as speed=0.2,height=0.58. [default: the middle of the
            ranges of use]
        out: New file for the figure. [default: gait.png or the next free name]
    """
    from stepgap.control.limit_cycle import fixed_point, reachable_set
    from stepgap.experiment.nominal import load_nominal
    from stepgap.experiment.settings import read_experiment
    from stepgap.records.text import values_by_name
    from stepgap.report.own_style import own_style
    from stepgap.step import StepFailed

    settings = read_experiment(experiment, overrides or [])
    space = settings.space
    wanted = values_by_name("--state", state, space.state, space.state_centre)
    if out:
        check_new(out, "--out")
    nominal, _, warnings = load_nominal(settings)
    for sentence in warnings:
        warn(sentence)
    try:
        point = fixed_point(nominal, wanted)
    except StepFailed as error:
        raise InputError(
            f"{named_values(space.state, wanted)}: no command makes a step from this state ({error})"
        ) from None
    reachable = reachable_set(nominal, point.state)
    picture = out or free_name(Path("gait.png"))
    content = BytesIO()
    with own_style():
        from matplotlib.backend_bases import FigureCanvasBase

        from stepgap.report.gait import describe_gait, gait_figure

        form = format_by_name(picture, FigureCanvasBase.filetypes)
        print(describe_gait(nominal, point, reachable))
        gait_figure(nominal.space, point, reachable).savefig(content, dpi=150, format=form)
    write_new(picture, "--out", content.getvalue())
