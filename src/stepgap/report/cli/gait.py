"""The verbs `stepgap gait` and `stepgap gait knobs`."""

from io import BytesIO
from pathlib import Path

from cyclopts import App

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, format_by_name, free_name, write_new
from stepgap.cli.map_table import named_values
from stepgap.cli.options import SETTINGS_HELP, Flag, NamedValues, Overrides, add_verb, values_by_name
from stepgap.cli.terminal import announces_compilation, warn


@announces_compilation
def limit_cycle_(
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
    picture, content = out or free_name(Path("gait.png")), BytesIO()
    with own_style():
        from matplotlib.backend_bases import FigureCanvasBase

        from stepgap.report.gait import describe_gait, gait_figure

        form = format_by_name(picture, FigureCanvasBase.filetypes)
        print(describe_gait(nominal, point, reachable))
        gait_figure(nominal.space, point, reachable).savefig(content, dpi=150, format=form)
    write_new(picture, "--out", content.getvalue())


@announces_compilation
def knobs_(
    experiment: Path | None = None, /, *, out: Path | None = None, quiet: Flag = False, overrides: Overrides = None
) -> None:
    """Compare what could be the step command: effects of settings on the next state, coupling of pairs, and loads.

    Args:
        experiment: TOML file of settings.
        out: New file for the figure. [default: knobs.png or the next free name]
        quiet: Show no progress.
    """
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.knobs import study_knobs
    from stepgap.experiment.settings import read_experiment
    from stepgap.report.own_style import own_style

    settings = read_experiment(experiment, overrides or [])
    if out:
        check_new(out, "--out")
    with progress_bar("gaits", quiet) as progress:
        study = study_knobs(settings, progress)
    picture, content = out or free_name(Path("knobs.png")), BytesIO()
    with own_style():
        from matplotlib.backend_bases import FigureCanvasBase

        from stepgap.report.knobs import describe_knobs, knobs_figure

        form = format_by_name(picture, FigureCanvasBase.filetypes)
        print(describe_knobs(study))
        knobs_figure(study).savefig(content, dpi=150, format=form, bbox_inches="tight")
    write_new(picture, "--out", content.getvalue())


gait = App(name="gait", help_epilogue=SETTINGS_HELP)
gait.default(limit_cycle_)
add_verb(gait, "knobs", knobs_)
