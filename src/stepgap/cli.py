"""The command line, and the only place that chooses a plant.

Exit codes: 0 done; 2 bad input, with one line that says what would be right; 1 any other failure.
"""

import os
import re
import sys
from collections.abc import Sequence
from datetime import datetime
from pathlib import Path
from typing import Annotated, Any

import cyclopts
import numpy as np
from cyclopts import App, Parameter

from stepgap.experiment import Experiment, InputError, load_reference, read_experiment, write_experiment

Overrides = Annotated[list[tuple[str, str]] | None, Parameter(parse=False)]
"""Settings given as `--table.key value`."""

OVERRIDE = re.compile(r"--([a-z_][a-z0-9_-]*\.[a-z0-9_.-]+)(?:=(.*))?", re.DOTALL)

app = App(
    name="stepgap",
    help="Close the sim-to-real gap of a legged robot one step at a time.",
    help_epilogue="Any setting of an experiment can be given as --TABLE.KEY VALUE, such as --gains.stiffness 2400.",
)


def main(arguments: Sequence[str] | None = None) -> None:
    """Runs the command and exits with its code."""
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in arguments
    try:
        tokens, overrides = split_overrides([argument for argument in arguments if argument != "--debug"])
        command, bound, ignored = app.parse_args(tokens, exit_on_error=False, print_error=False)
        if "overrides" in ignored:
            bound.arguments["overrides"] = overrides
        elif overrides:
            raise InputError(f"--{overrides[0][0]}: this verb takes no settings")
        command(*bound.args, **bound.kwargs)
    except KeyboardInterrupt:
        sys.exit("\nstepgap: stopped; --resume goes on with a run")
    except Exception as error:
        if debug:
            raise
        code = 2 if isinstance(error, InputError | cyclopts.CycloptsError) else 1
        kind = "" if code == 2 or str(error) else f"{type(error).__name__} "
        print(f"stepgap: {kind}{' '.join(str(error).split())}", file=sys.stderr)
        sys.exit(code)


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
        elif left:
            overrides.append((match[1], left.pop(0)))
        else:
            raise InputError(f"{argument}: give a value")
    return rest, overrides


@app.command
def run(
    experiment: Path | None = None,
    /,
    *,
    out: Path | None = None,
    seed: int | None = None,
    iterations: int | None = None,
    resume: bool = False,
    quiet: bool = False,
    overrides: Overrides = None,
) -> None:
    """Run the whole sim-to-real experiment on the twin: deploy, learn, redeploy, report.

    Args:
        experiment: TOML file of settings; without one, the paper's experiment.
        out: Folder for the results; without it a new one under runs/.
        seed: Of all randomness.
        iterations: Redeployments at most.
        resume: Go on with the run in --out that was broken off.
        quiet: Print nothing but the report's path.
    """
    from stepgap.hopper.apex_map import ApexMap
    from stepgap.plants.plant import Plant
    from stepgap.plants.rig_plant import RigPlant
    from stepgap.progress import Progress
    from stepgap.report import write_report
    from stepgap.rigs.twin.twin import Twin
    from stepgap.sim_to_real import run as run_experiment

    shorthand = [("seed", seed), ("learning.iterations", iterations)]
    changes = [*(overrides or []), *((name, str(value)) for name, value in shorthand if value is not None)]
    if resume:
        settings, folder = _settings_to_resume(experiment, out, changes)
    else:
        settings, folder = read_experiment(experiment, changes), out or _new_folder()
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    reference = load_reference(settings, nominal.space)
    _check_reach(nominal, reference, settings.reference)
    if not resume:
        _start_folder(folder, settings, reference)

    def make_plant(rng: np.random.Generator) -> Plant:
        twin = Twin(settings.robot, settings.gap, rng)
        return RigPlant(twin, settings.robot, settings.gains, settings.command)

    try:
        with Progress(nominal.space, len(reference), settings.learning.iterations, quiet) as progress:
            run_experiment(
                nominal, make_plant, reference, settings.learning, folder, settings.seed, progress.observer
            )
        report = write_report(folder)
    except ValueError as error:
        raise InputError(str(error)) from error
    print(report)


@app.command
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
        speed: Forward speed at the apex [m/s].
        height: Height of the apex [m].
        out: Picture to save; without it gait.png or the next free name.
    """
    from stepgap.control.limit_cycle import fixed_point, reachable_set
    from stepgap.hopper.apex_map import ApexMap
    from stepgap.report.gait import describe_gait, gait_figure

    if not np.isfinite([speed, height]).all():
        raise InputError(f"--speed {speed} --height {height}: both must be finite numbers")
    settings = read_experiment(experiment, overrides or [])
    if out and out.exists():
        raise InputError(f"{out}: exists already; choose another --out")
    nominal = ApexMap(settings.robot, settings.gains, settings.command)
    point = fixed_point(nominal, [speed, height])
    reachable = reachable_set(nominal, point.state)
    print(describe_gait(nominal.space, point, reachable))
    picture = out or _free_name("gait", ".png")
    try:
        gait_figure(nominal.space, point, reachable).savefig(picture, dpi=150)
    except (OSError, ValueError) as error:
        raise InputError(f"{picture}: cannot be written: {error}") from None
    print(picture)


@app.command
def report(folder: Path, /) -> None:
    """Make the report of a run anew.

    Args:
        folder: Folder of the run.
    """
    from stepgap.report import write_report

    try:
        print(write_report(folder))
    except (ValueError, OSError) as error:
        raise InputError(str(error)) from error


def _new_folder() -> Path:
    return Path("runs") / datetime.now().strftime("%Y-%m-%d_%H-%M-%S")


def _free_name(stem: str, suffix: str) -> Path:
    """The first of STEM.SUFFIX, STEM_2.SUFFIX, … that does not exist."""
    path, number = Path(stem + suffix), 1
    while path.exists():
        number += 1
        path = Path(f"{stem}_{number}{suffix}")
    return path


def _start_folder(folder: Path, settings: Experiment, reference: Any) -> None:
    """Makes the run's folder with its resolved settings; never takes one that holds a run."""
    if (folder / "experiment.toml").exists() or (folder / "steps.csv").exists():
        raise InputError(f"{folder}: holds a run already; go on with it by --resume, or choose another --out")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_experiment(folder, settings, reference)
        latest = folder.parent / "latest"
        if folder.parent.name == "runs" and (latest.is_symlink() or not latest.exists()):
            latest.unlink(missing_ok=True)
            latest.symlink_to(folder.name)
    except OSError as error:
        raise InputError(f"{folder}: cannot be written: {os.strerror(error.errno or 0)}; choose another --out") from None


def _settings_to_resume(
    experiment: Path | None, out: Path | None, changes: Sequence[tuple[str, str]]
) -> tuple[Experiment, Path]:
    """Settings and folder of a run that was broken off."""
    if out is None:
        raise InputError("--resume: say which run by --out RUN")
    if experiment or changes:
        raise InputError("--resume: the run goes on with the settings it has; give no others")
    if not (out / "experiment.toml").is_file():
        raise InputError(f"{out}: no experiment.toml there, so there is no run to resume; start one without --resume")
    return read_experiment(out / "experiment.toml"), out


def _check_reach(nominal: Any, reference: Any, name: str) -> None:
    """Raises InputError where the nominal map cannot hold a target."""
    from stepgap.control.limit_cycle import fixed_point

    targets, first = np.unique(reference.targets, axis=0, return_index=True)
    for target, step in zip(targets[np.argsort(first)], np.sort(first), strict=True):
        point = fixed_point(nominal, target)
        if not point.held:
            wanted = ", ".join(f"{q.name} {value:g} {q.unit}" for q, value in zip(nominal.space.state, target, strict=True))
            raise InputError(
                f"reference {name}, step {step + 1}: {wanted} is out of reach: the model cannot hold it within the "
                f"command bounds; `stepgap gait` shows what it can"
            )
