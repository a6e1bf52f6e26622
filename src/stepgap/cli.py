"""The command line; verbs in files of their own are read when they are called.

Exit codes: 0 done; 2 bad input, with one line that says what would be right; 130 Ctrl-C; 1 any other failure.
"""

import json
import re
import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from functools import wraps
from inspect import signature
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import cyclopts
from cyclopts import App, Parameter, validators

from stepgap.new_files import check_new, free_name, words_of, write_new, writing

if TYPE_CHECKING:  # what takes time to import is imported where it is used, so that --help is quick
    from stepgap.plants.tick import Tick
    from stepgap.step import StepMap

Overrides = Annotated[list[tuple[str, str]] | None, Parameter(parse=False)]
"""Settings given as `--table.key value`."""

Program = Annotated[list[str] | None, Parameter(parse=False)]
"""A command line given after `--`."""

OVERRIDE = re.compile(r"--([a-z_][a-z0-9_-]*\.[a-z0-9_.-]+)(?:=(.*))?", re.DOTALL)

STOPPED = 130
"""Exit code after Ctrl-C, as shells have it."""

POINT = {"speed": 0.2, "height": 0.58, "fx": 0.0, "fy": 0.0}
"""The step that `map` takes if none is given, SI units."""
MOST_POINTS = 50
"""A table has the fourth power of this many commands."""

DEBUG_HELP = "--debug shows where an error arose."
"""All that the help of a verb without settings ends with."""

app = App(
    name="stepgap",
    help="Close the sim-to-real gap of a legged robot one step at a time.",
    help_epilogue="Any setting of an experiment can be given as --TABLE.KEY VALUE, such as --gains.stiffness 2400. "
    f"Tables: robot, gains, command, learning, gap; the experiment.toml of any run lists every key. {DEBUG_HELP}",
    help_format="plaintext",
    default_parameter=Parameter(negative=(), show_default=False),
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command and exits with its code."""
    arguments, program = split_program(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    try:
        tokens, overrides = split_overrides([argument for argument in arguments if argument != "--debug"])
        command, bound, ignored = app.parse_args(tokens, exit_on_error=False, print_error=False)
        if "overrides" in ignored:
            bound.arguments["overrides"] = overrides
        elif overrides:
            raise _bad_input(f"--{overrides[0][0]}: this verb takes no settings")
        if "program" in ignored:
            bound.arguments["program"] = program
        elif program:
            raise _bad_input(f"-- {program[0]}: this verb runs no other command")
        command(*bound.args, **bound.kwargs)
    except KeyboardInterrupt as interrupt:
        _say(f"stopped{interrupt}")
        sys.exit(STOPPED)
    except Exception as error:
        if debug:
            raise
        bad_input = _is_bad_input(error)
        foreseen = bad_input or type(error).__module__.startswith("stepgap.")
        _say(f"{words_of(error)}{_hint(error)}" if foreseen else f"{type(error).__name__}: {error}")
        sys.exit(2 if bad_input else 1)


def _say(message: str) -> None:
    """Prints one line on stderr."""
    print(f"stepgap: {' '.join(message.split())}", file=sys.stderr)


def _bad_input(message: str) -> ValueError:
    from stepgap.experiment import InputError

    return InputError(message)


def _is_bad_input(error: Exception) -> bool:
    if isinstance(error, cyclopts.CycloptsError) or _is_forbidden(error):
        return True
    from stepgap.experiment import InputError
    from stepgap.learning.step_log import RecordError

    return isinstance(error, InputError | RecordError)


def _is_forbidden(error: Exception) -> bool:
    """Whether the user named a file or folder that is another's to read or write."""
    return isinstance(error, PermissionError) and error.filename is not None


def _hint(error: Exception) -> str:
    """What an option that is none may have been meant for: a setting, where the verb takes settings."""
    if not isinstance(error, cyclopts.UnknownOptionError) or "Did you mean" in str(error) or not error.target:
        return ""
    if "overrides" not in signature(error.target).parameters:
        return ""
    return " If it is a setting, name its table, too, as in --robot.body_mass 1.6."


def split_program(arguments: Sequence[str]) -> tuple[list[str], list[str]]:
    """Parts a command line given after `--` from the arguments before it."""
    end = list(arguments).index("--") if "--" in arguments else len(arguments)
    return list(arguments[:end]), list(arguments[end + 1 :])


def split_overrides(arguments: Sequence[str]) -> tuple[list[str], list[tuple[str, str]]]:
    """Parts `--table.key value` and `--table.key=value` from the other arguments.

    Raises:
        InputError: A setting has no value.
    """
    rest, overrides, left = [], [], list(arguments)
    while left:
        argument = left.pop(0)
        match = OVERRIDE.fullmatch(argument)
        if not match:
            rest.append(argument)
        elif match[2] is not None:
            overrides.append((match[1], match[2]))
        elif left and not left[0].startswith("--"):
            overrides.append((match[1], left.pop(0)))
        else:
            raise _bad_input(f"{argument}: give a value")
    return rest, overrides


def says_if_it_compiles(verb: Callable[..., None]) -> Callable[..., None]:
    """Has a verb that hops say on stderr, unless --quiet, why it takes longer the first time."""

    @wraps(verb)
    def saying(*arguments: Any, **options: Any) -> None:
        from stepgap.hybrid.compiling import telling_of_compilation

        def tell() -> None:
            if not options.get("quiet"):
                _say("compiling for this machine; takes about half a minute, once")

        with telling_of_compilation(tell):
            verb(*arguments, **options)

    return saying


@app.command
@says_if_it_compiles
def run(
    experiment: Path | None = None,
    /,
    *,
    out: Path | None = None,
    reference: str | None = None,
    plant: str | None = None,
    rig: str | None = None,
    arm: bool = False,
    seed: str | None = None,
    iterations: str | None = None,
    calibrate: str | None = None,
    online: bool = False,
    warm_start: str | None = None,
    resume: bool = False,
    quiet: bool = False,
    view: bool = False,
    host: str | None = None,
    port: Annotated[int | None, Parameter(validator=validators.Number(gte=1, lt=2**16))] = None,
    json: bool = False,
    overrides: Overrides = None,
) -> None:
    """Run the whole sim-to-real experiment: deploy, learn, redeploy, report. Without more, on the twin.

    Args:
        experiment: TOML file of settings; without one, the paper's experiment.
        out: Folder for the results; without it a new one under runs/.
        reference: CSV file of targets, one row per step; without it, the paper's.
        plant: What hops: twin, emulated-ring (the twin on an EtherCAT bus in software), or a rig such as ethercat.
        rig: File that describes the rig, such as rig.toml.
        arm: Give the rig torque; `stepgap rig check` must have passed.
        seed: Of all randomness, a whole number.
        iterations: Redeployments at most.
        calibrate: Hops before the first deployment whose commands are chosen for what they teach.
        online: Learn from hop to hop, from the first one on.
        warm_start: Folder of a run whose steps are learnt from before the first deployment.
        resume: Go on with the run in --out that was broken off.
        quiet: Print nothing but the report's path.
        view: Show it in the browser while it goes on, and until Ctrl-C when it is over.
        host: Address that --view is served on; without it, only this machine sees it.
        port: Of --view; without it the first free one from 8080 on.
        json: Print lines of JSON on stdout, for programs: one for every step and deployment, the report's path at last.
    """
    from stepgap.experiment import load_known, load_reference, read_experiment
    from stepgap.hopper.apex_map import ApexMap
    from stepgap.interrupt import terminated_as_interrupted
    from stepgap.live_ticks import TickRecorder
    from stepgap.progress import Progress, shown_count, tell_event, telling_events
    from stepgap.report_verb import EVERY, report_run
    from stepgap.run_plants import choose_plants
    from stepgap.run_verb import check_reach, dated_folder, folder_to_resume, start_folder
    from stepgap.sim_to_real import run as run_experiment
    from stepgap.view.live import LiveView

    if not view and (host or port):
        raise _bad_input("--host, --port: of the page that --view shows; give --view, too")
    shorthand = [
        ("reference", _quoted(reference)),
        ("plant", _quoted(plant)),
        ("rig", _quoted(rig)),
        ("warm_start", _quoted(warm_start)),
        ("seed", seed),
        ("learning.iterations", iterations),
        ("learning.calibration", calibrate),
        ("learning.online", "true" if online else None),
    ]
    changes = [*(overrides or []), *((name, value) for name, value in shorthand if value is not None)]
    folder = folder_to_resume(experiment, out, changes) if resume else out or free_name(dated_folder())
    settings = read_experiment(folder / "experiment.toml" if resume else experiment, changes)
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    targets = load_reference(settings, nominal.space)
    check_reach(nominal, targets, settings.reference)
    known = load_known(settings, nominal.space)
    live = LiveView(folder, host or "127.0.0.1", port) if view else None
    recorder = TickRecorder(EVERY)

    def on_tick(tick: "Tick") -> None:
        recorder.on_tick(tick)
        if live:
            live.on_tick(tick)

    plants = choose_plants(settings, targets, arm, folder, on_tick)
    if not resume:
        start_folder(folder, settings, targets, known)
    try:
        with (
            terminated_as_interrupted(),
            live or nullcontext(),
        ):
            with Progress(nominal.space, len(targets), settings.learning.iterations, quiet) as progress:
                observer = telling_events(progress.observer, nominal.space) if json else progress.observer
                observer = recorder.observing(observer)
                run_experiment(
                    nominal,
                    plants.make,
                    targets,
                    settings.learning,
                    folder,
                    settings.seed,
                    live.observing(observer) if live else observer,
                    plants.measure_spread,
                    plants.replays,
                    known,
                )
            with shown_count("replay", quiet) as tell:
                written = report_run(folder, tell, recorder.kept)
            try:
                if json:
                    tell_event("report", path=str(written.path))
                else:
                    print(written.path, flush=True)
                if written.left_out and not quiet:
                    _say_left_out(written.left_out)
                if live:
                    live.stay()
            except KeyboardInterrupt:  # the run is over: this ends its page only
                print(file=sys.stderr)
    except KeyboardInterrupt:
        again = f"stepgap run --out {shlex.quote(str(folder))} --resume{' --arm' if arm else ''}"
        raise KeyboardInterrupt(f"; go on with: {again}") from None


def _say_left_out(parts: Sequence[str]) -> None:
    """Says what a report does without."""
    _say(f"left out of the report: {'; '.join(parts)}")


def _quoted(text: str | None) -> str | None:
    """The TOML of a text."""
    return None if text is None else json.dumps(text, ensure_ascii=False)


@app.command
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
    from stepgap.experiment import read_experiment
    from stepgap.hopper.apex_map import ApexMap
    from stepgap.report.gait import describe_gait, gait_figure
    from stepgap.step import StepFailed

    if not (isfinite(speed) and isfinite(height)):
        raise _bad_input(f"--speed {speed} --height {height}: both must be finite numbers")
    settings = read_experiment(experiment, overrides or [])
    if out and out.exists():
        raise _bad_input(f"{out}: exists already; choose another --out")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    try:
        point = fixed_point(nominal, [speed, height])
    except StepFailed as error:
        raise _bad_input(
            f"--speed {speed:g} --height {height:g}: no command makes a step from there ({error})"
        ) from None
    reachable = reachable_set(nominal, point.state)
    figure = gait_figure(nominal.space, point, reachable)
    picture = out or free_name(Path("gait.png"))
    formats = figure.canvas.get_supported_filetypes()
    if picture.suffix[1:].lower() not in formats:
        raise _bad_input(f"{picture}: the name must end with one of .{', .'.join(formats)}")
    try:
        figure.savefig(picture, dpi=150)
    except OSError as error:
        raise _bad_input(f"{picture}: cannot be written: {error.strerror}; choose another --out") from None
    print(describe_gait(nominal.space, point, reachable))
    print(picture)


@app.command(name="map")
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
    from stepgap.experiment import read_experiment
    from stepgap.hopper.apex_map import ApexMap
    from stepgap.hopper.sampled_map import SampledApexMap

    single = {"speed": speed, "height": height, "fx": fx, "fy": fy}
    ways = {
        "--csv": csv is not None,
        "--table": table is not None,
        "--speed, --height, --fx, --fy": any(value is not None for value in single.values()),
    }
    if sum(ways.values()) > 1:
        raise _bad_input(f"{' and '.join(name for name, given in ways.items() if given)}: give only one of them")
    if out and not csv:
        raise _bad_input("--out: goes with --csv; one point is printed")
    count = 15 if points is None else int(points) if re.fullmatch("[0-9]{1,3}", points) else 0
    if points is not None and (not table or not 2 <= count <= MOST_POINTS):
        raise _bad_input(f"--points {points}: goes with --table, a whole number between 2 and {MOST_POINTS}")
    settings = read_experiment(experiment, overrides or [])
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    if tick is not None:
        try:
            nominal = SampledApexMap(settings.robot, settings.gains, settings.command, tick)
        except ValueError as error:
            raise _bad_input(f"--tick: {error}") from None
    if csv:
        _map_rows(nominal, csv, out)
    elif table:
        _map_table(nominal, table, count, settings.seed)
    else:
        _map_point(nominal, {name: POINT[name] if value is None else value for name, value in single.items()})


def _map_point(nominal: "StepMap", point: dict[str, float]) -> None:
    """Prints the next apex of one step and its derivatives."""
    from stepgap.map_verb import describe_step
    from stepgap.step import StepFailed

    given = " ".join(f"--{name} {value:g}" for name, value in point.items())
    if not all(map(isfinite, point.values())):
        raise _bad_input(f"{given}: all must be finite numbers")
    state, command = [point["speed"], point["height"]], [point["fx"], point["fy"]]
    try:
        next_state = nominal(state, command)
    except StepFailed as error:
        raise _bad_input(f"{given}: no step ends in an apex from there ({error})") from None
    print(describe_step(nominal.space, next_state, nominal.jacobian(state, command)))


def _map_rows(nominal: "StepMap", rows: Path, out: Path | None) -> None:
    """Evaluates the rows of a CSV file."""
    from stepgap.map_verb import outcome_rows, read_points

    if out:
        check_new(out, "--out")
    try:
        points = read_points(rows, nominal.space)
    except ValueError as error:
        raise _bad_input(str(error)) from None
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

    from stepgap.control.command_table import build_table, measure_table
    from stepgap.control.command_table_file import write_table
    from stepgap.map_verb import describe_table
    from stepgap.progress import shown_count

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


@app.command
def fit(
    *log: Path,
    columns: Path | None = None,
    state: str | None = None,
    next_state: Annotated[str | None, Parameter(name="--next")] = None,
    command: str | None = None,
    target: str | None = None,
    predicted: str | None = None,
    deployment: str | None = None,
    step: str | None = None,
    nominal: Literal["map", "predicted", "target", "state"] | None = None,
    experiment: Path | None = None,
    folds: int | None = None,
    out: Path | None = None,
    plot: Path | None = None,
    save: Path | None = None,
    overrides: Overrides = None,
) -> None:
    """Fit every residual to recorded steps, score it on steps held out, and say what there is to learn.

    Args:
        log: Folders of runs or their steps.csv; or CSV files of any origin, if their columns are named.
        columns: TOML file that names columns; its keys are the options from here to --step, and units and factors.
        state: Columns of the state before the step, as NAME,NAME or as NAME=COLUMN,NAME=COLUMN.
        next_state: Columns of the state after it; without them that of the following row.
        command: Columns of the command.
        target: Columns of the target; without --command it stands for the command.
        predicted: Columns of the nominal next state.
        deployment: Column that tells deployments apart.
        step: Column that counts the steps; rows belong together where it goes up by one.
        nominal: What stands for the nominal next state: the hopper's map, the predictions, the target, the state.
        experiment: TOML file of settings of the hopper's map; without it those of the runs.
        folds: Hold out so many contiguous blocks; without it whole deployments, or 10 blocks of a single one.
        out: JSON file for all numbers.
        plot: Picture of predicted against actual errors.
        save: JSON file for the best residual, fitted to all steps.
    """
    from threadpoolctl import threadpool_limits

    from stepgap.fit_verb import best_residual, choose_folds, describe_lesson, fit_report, read_lesson, verdicts
    from stepgap.fit_verb import show_validation as show
    from stepgap.learning.columns import read_columns
    from stepgap.learning.residual_fit import KINDS
    from stepgap.learning.validation import validate
    from stepgap.progress import shown_count
    from stepgap.report.fit import FORMATS, fit_picture

    if not log:
        raise _bad_input("LOG: none given; give folders of runs, or CSV files and what their columns hold")
    for option, file in (("--out", out), ("--plot", plot), ("--save", save)):
        if file:
            check_new(file, option)
    form = plot.suffix[1:].lower() if plot else ""
    if plot and form not in FORMATS:
        raise _bad_input(f"{plot}: the name must end with one of .{', .'.join(FORMATS)}")
    given = {"state": state, "next": next_state, "command": command, "target": target, "predicted": predicted}
    given |= {"deployment": deployment, "step": step}
    mapping = read_columns(columns, {name: text for name, text in given.items() if text is not None})
    lesson = read_lesson(log, mapping, nominal, experiment, overrides or [])
    parts = choose_folds(lesson.steps, folds)
    print(describe_lesson(lesson, parts), flush=True)
    with threadpool_limits(limits=1, user_api="blas"), shown_count("fits") as tell:
        validation = validate(KINDS, lesson.steps, parts, tell)
    show(lesson.steps.space.state, validation, sys.stdout)
    print(verdicts(lesson.steps.space.state, validation))
    if out:
        write_new(out, "--out", json.dumps(fit_report(log, lesson, validation), indent=1))
    if plot:
        write_new(plot, "--plot", fit_picture(lesson.steps.space.state, validation, form))
    if save:
        write_new(save, "--save", json.dumps(best_residual(lesson.steps, validation).to_dict()))


app.command(
    "stepgap.cli_bench:bench", name="bench", help="Measure how fast, how exact and how quick to learn StepGap is here."
)
app.command("stepgap.cli_rig:rig", name="rig", help="Bring up a robot, or try without one.")


@app.command(help_epilogue=DEBUG_HELP)
def report(folders: list[Path], /, *, out: Path | None = None) -> None:
    """Make the report of a run anew; of several runs, a page that compares them.

    Args:
        folders: Folder of the run, or of each run.
        out: HTML file of a comparison; without it comparison.html beside the first run, or the next free name.
    """
    from stepgap.progress import shown_count
    from stepgap.report_verb import compare_runs, report_run

    if len(folders) > 1:
        page = out or free_name(folders[0].resolve().parent / "comparison.html")
        compare_runs(folders, page)
    elif out:
        raise _bad_input("--out: goes with several runs; the report of one lies in its folder")
    else:
        with shown_count("replay") as tell:
            page, left_out = report_run(folders[0], tell)
        if left_out:
            _say_left_out(left_out)
    print(page)


for verb, words in {
    "export": "Write a run for other programs: MATLAB, tables, players of tick logs, viewers of MuJoCo models.",
    "recover": "Save what is whole of a steps.csv or a log of ticks that was cut off or damaged.",
    "doctor": "Say what this machine has: versions, cores, graphics, rights for real time, the cache, extras.",
}.items():
    # read when called: they import this module
    app.command(f"stepgap.cli_data:{verb}", name=verb, help=words, help_epilogue=DEBUG_HELP)
app.command(
    "stepgap.cli_view:view",
    name="view",
    help="Show a run in the browser, also one that goes on.",
    help_epilogue=DEBUG_HELP,
)
