"""The verb `stepgap run`."""

import json as json_format
import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from cyclopts import Parameter

from stepgap.base.errors import InputError, StepGapError
from stepgap.cli.options import (
    Address,
    FileName,
    Flag,
    FolderName,
    Integer,
    Name,
    NamedValues,
    Note,
    Overrides,
    Port,
    Program,
)
from stepgap.cli.terminal import announces_compilation, check_consent, is_output_error, open_page, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.experiment.displays import LivePage, WrittenReport
    from stepgap.experiment.loop import Setup
    from stepgap.experiment.nominal import Nominal
    from stepgap.experiment.recorders import TickRecorder
    from stepgap.experiment.settings import Experiment
    from stepgap.plants.compiled_rig import Rows
    from stepgap.plants.ticks.stream import OnTicks


@Parameter(name="*")
@dataclass(frozen=True)
class Shorthand:
    """Settings of an experiment that have their own options.

    Attributes:
        name: What this run, or its robot, is called, for its report, comparisons and exported controllers.
        note: A sentence on this run, for its report and comparisons.
        reference: CSV file of targets, one row per step. [default: the robot's; for the hopper that of the paper]
        target: State wanted at the end of every step in SI units, such as speed=0.3,height=0.6, instead of a reference;
            what it does not name is free.
        steps: Number of steps with this target. [default: 50]
        plant: Plant that steps: a simulation of the robot (of the hopper: twin, or emulated-ring, the twin on an
            EtherCAT bus in software), process (the program given after two dashes, as in -- ./robot), or a rig, such as
            ethercat. [default: the first simulation; of the hopper: twin]
        rig: File that describes the rig, such as rig.toml.
        method: Settings of learning and control before others change them: default; paper, the method as published; or
            a simple one to compare with, integral, rls (recursive least squares) or affine (a linear map).
        gap: Preset of the differences between the simulated robot and its model, such as none; random:7 is random
            robot 7.
        seed: Random seed. [default: 0]
        iterations: Largest number of redeployments. [default: 4]
        explore: Number of exploratory steps before the first deployment; with a prior at most that number. [default: 0]
        online: Learn after every step, from the first one on.
        warm_start: Folder of an earlier run, or of many, whose steps are learned from before the first deployment;
            many compete with each other.
        prior: What learning expects before the first step: robot (of many robots of this kind, where there is such a
            prior), none, or a file that `stepgap prior` wrote, or a folder of such files, which compete. [default:
            robot]
    """

    name: Name | None = None
    note: Note | None = None
    reference: FileName | None = None
    target: NamedValues | None = None
    steps: Integer | None = None
    plant: Name | None = None
    rig: FileName | None = None
    method: Name | None = None
    gap: Name | None = None
    seed: Integer | None = None
    iterations: Integer | None = None
    explore: Integer | None = None
    online: Flag = False
    warm_start: FolderName | None = None
    prior: FileName | None = None

    def overrides(self) -> list[tuple[str, str]]:
        """Names and TOML values of the options that were given; a target is a reference."""
        given = {name: value for name, value in vars(self).items() if value is not None and value is not False}
        target = given.pop("target", None)
        steps = given.pop("steps", None)
        if target is None and steps is not None:
            raise InputError("--steps: valid only with --target, whose steps they are")
        if target is not None:
            given["reference"] = _constant_reference(target, steps, self.reference)
        return [(name, json_format.dumps(value, ensure_ascii=False)) for name, value in given.items()]


@Parameter(name="*")
@dataclass(frozen=True)
class Display:
    """Output of a run while it is running.

    Attributes:
        quiet: Print only the path of the report.
        view: Show the run in the browser while it is running, and afterwards until Ctrl-C.
        host: Address to serve the page of --view on. [default: 127.0.0.1, which only this machine can open]
        port: TCP port of the page of --view. [default: the first free one from 8080 on]
        open: Open the report in the browser at the end.
        json: Print JSON lines on stdout, for programs: one for every step and deployment, the report's path last.
    """

    quiet: Flag = False
    view: Flag = False
    host: Address | None = None
    port: Port | None = None
    open: Flag = False
    json: Flag = False

    def check(self) -> None:
        """Raises InputError where an option of the page is given without the page."""
        if not self.view and (self.host or self.port):
            raise InputError("--host, --port: valid only with --view, whose page they belong to")


def _constant_reference(target: str, steps: int | None, reference: str | None) -> str:
    """The setting of a reference that is one target."""
    from stepgap.experiment.settings import is_constant_target

    if reference is not None:
        raise InputError("--target, --reference: give only one of them")
    if not is_constant_target(target):
        raise InputError(f"--target {target}: it must be names with numbers, such as speed=0.3,height=0.6")
    return target if steps is None else f"{target},steps={steps}"


NO_SHORTHAND = Shorthand()
NORMAL = Display()


@announces_compilation
def run_verb(
    experiment: Path | None = None,
    /,
    *,
    out: Path | None = None,
    shorthand: Shorthand = NO_SHORTHAND,
    arm: Flag = False,
    resume: Flag = False,
    extend: Integer | None = None,
    display: Display = NORMAL,
    overrides: Overrides = None,
    program: Program = None,
) -> None:
    """Run the whole sim-to-real experiment: deploy, learn, redeploy, report. On a simulation, unless a plant is given.

    Args:
        experiment: TOML file of settings. [default: the defaults of the robot; of the hopper, the experiment
            of the paper]
        out: New folder for the results. [default: a new one in runs/]
        arm: Let the rig apply torque; `stepgap rig check` must have passed, and a person must be at the terminal.
        resume: Resume the interrupted run in --out.
        extend: Make this many more redeployments of the finished run in --out.
    """
    from stepgap.base.signals import terminated_as_interrupted
    from stepgap.cli.nominal import nominal_with_progress
    from stepgap.experiment.inputs import load_reference, write_experiment
    from stepgap.experiment.nominal import check_surrogate
    from stepgap.experiment.plants import PlantRequest, plant_compiled_beside
    from stepgap.experiment.run_start import folder_to_continue, load_setup, run_folder, start_folder

    if arm:
        check_consent("--arm")
    display.check()
    if resume and extend is not None:
        raise InputError(
            "--resume, --extend: give only --resume for an interrupted run, only --extend for a finished one"
        )
    changes = [*(overrides or []), *shorthand.overrides()]
    continued = resume or extend is not None
    if continued:
        out = folder_to_continue("--resume" if resume else "--extend", experiment, out, changes)
    with run_folder(out) as folder:
        settings = _settings(experiment, folder, changes, continued, extend)
        recorder, live = _watchers(settings, folder, display)
        reference = load_reference(settings, settings.space)
        with plant_compiled_beside(settings):
            nominal = nominal_with_progress(settings, reference)
            if nominal.surrogate:  # it was fitted now
                check_surrogate(nominal.surrogate)
        on_ticks = _all_of(recorder.on_ticks, live)
        request = PlantRequest(settings, reference, folder, arm, on_ticks, program or [])
        try:
            setup = load_setup(request, nominal.map)
        except InputError as error:
            raise InputError(f"{error}{_kept(nominal)}") from error
        write = partial(write_experiment, folder, settings, reference, setup.known, nominal.file)
        if not continued:
            start_folder(folder, write)
        on_execution = write if extend is not None else lambda: None
        remedy = _how_to_resume(folder, arm, program)
        with _stoppable(folder, remedy, continued), terminated_as_interrupted(), live or nullcontext():
            _execute(setup, folder, recorder, live, display, on_execution)
            _finish(_report(folder, recorder, display), live, display)


@contextmanager
def _stoppable(folder: Path, remedy: str, continued: bool) -> Iterator[None]:
    """Says how to resume a run that is stopped inside, and removes a new folder in which no step is recorded."""
    from stepgap.experiment.run_start import discard_unrecorded
    from stepgap.plants.process import ProcessFault

    try:
        yield
    except StepGapError as error:
        if not continued:
            discard_unrecorded(folder)
        if isinstance(error, ProcessFault) and (folder / "experiment.toml").exists():
            raise ProcessFault(f"{error}; {remedy}") from None
        raise
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"; {remedy}") from None
    except OSError as error:
        if is_output_error(error):
            warn(f"the run was stopped; {remedy}")
        raise


def _kept(nominal: "Nominal") -> str:
    """Keeps a surrogate that was fitted for a run that does not start, and says where; empty if there is none."""
    from stepgap.cli.nominal import kept_surrogate

    path = kept_surrogate(nominal)
    return f" (its simulated steps are kept: --nominal.file {path})" if path else ""


def _how_to_resume(folder: Path, arm: bool, program: Sequence[str] | None) -> str:
    """The command that resumes a run, for a message."""
    end = f" -- {shlex.join(program)}" if program else ""
    return f"resume with: stepgap run --out {shlex.quote(str(folder))} --resume{' --arm' if arm else ''}{end}"


def _settings(
    experiment: Path | None, folder: Path, changes: Sequence[tuple[str, str]], continued: bool, extend: int | None
) -> "Experiment":
    """Settings of a run, whose names of state and command can be columns of `steps.csv`."""
    from stepgap.experiment.run import Run
    from stepgap.experiment.run_start import extended
    from stepgap.experiment.settings import read_experiment
    from stepgap.records.steps_csv import check_names

    if extend is not None:
        settings = extended(Run(folder), extend)
    else:
        file = folder / "experiment.toml" if continued else experiment
        settings = read_experiment(file, changes, recorded=continued)
    check_names(settings.space)
    return settings


def _watchers(settings: "Experiment", folder: Path, display: Display) -> "tuple[TickRecorder, LivePage | None]":
    """The recorder of the ticks that the report will show, and the live page, if it is wanted."""
    from stepgap.experiment.displays import load_display
    from stepgap.experiment.recorders import TickRecorder
    from stepgap.experiment.replay import find_kinematics
    from stepgap.records.missing import Missing
    from stepgap.records.motion_file import INTERVAL

    kinematics = find_kinematics(settings) if settings.simulated else None  # a rig has its own tick logs
    if isinstance(kinematics, Missing):
        kinematics = None
    recorder = TickRecorder(kinematics.units, kinematics.every(INTERVAL)) if kinematics else TickRecorder({}, 1)
    if not display.view:
        return recorder, None
    return recorder, load_display("live")(folder, display.host, display.port, kinematics)


def _all_of(record: "OnTicks", live: "LivePage | None") -> "OnTicks":
    """Function that passes ticks to the recorder and, if there is one, to the live page."""
    if live is None:
        return record

    def on_ticks(rows: "Rows", step: int) -> None:
        record(rows, step)
        live.on_ticks(rows, step)

    return on_ticks


def _execute(
    setup: "Setup",
    folder: Path,
    recorder: "TickRecorder",
    live: "LivePage | None",
    display: Display,
    on_execution: Callable[[], None],
) -> None:
    """Runs the experiment and displays its progress; `on_execution` is called before a deployment is executed."""
    from stepgap.base.garbage_collection import settled_heap
    from stepgap.cli.progress import RunProgress, printing_events
    from stepgap.experiment.loop import run_experiment
    from stepgap.experiment.recorders import TimeRecorder

    space = setup.nominal.space
    iterations = setup.learning.iterations
    with RunProgress(space, len(setup.reference), iterations, display.quiet) as progress, settled_heap():
        observer = printing_events(progress.observer, space) if display.json else progress.observer
        observer = replace(recorder.observing(observer), on_execution=on_execution)
        observer = TimeRecorder(folder).observing(observer)
        run_experiment(setup, folder, live.observing(observer) if live else observer)


def _report(folder: Path, recorder: "TickRecorder", display: Display) -> "WrittenReport":
    """Writes the report of the run."""
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.displays import load_display
    from stepgap.experiment.run import Run

    write_report = load_display("report")
    with progress_bar("report", display.quiet) as progress:
        return write_report(Run(folder, ticks=recorder.kept, on_replay=progress))


def _finish(report: "WrittenReport", live: "LivePage | None", display: Display) -> None:
    """Prints the path of the report, opens it if that is wanted, and keeps the live page until Ctrl-C."""
    from stepgap.cli.progress import print_event

    try:
        if display.json:
            print_event("report", path=str(report.path))
        else:
            print(report.path, flush=True)
        if report.missing and not display.quiet:
            warn(f"missing in the report: {'; '.join(report.missing)}")
        if display.open:
            open_page(report.path)
        if live:
            live.stay()
    except KeyboardInterrupt:
        print(file=sys.stderr)
