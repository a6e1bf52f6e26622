"""The verbs that run an experiment and make its report."""

import json
import shlex
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter, validators

from stepgap.base.output_files import free_name
from stepgap.base.settings_file import InputError
from stepgap.cli.app import Overrides, say, says_if_it_compiles

if TYPE_CHECKING:
    from stepgap.report import WrittenReport
    from stepgap.robots.hopper.tick import Tick
    from stepgap.view.live import LiveView


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
    from stepgap.base.signals import terminated_as_interrupted
    from stepgap.cli.progress import Progress, shown_count, telling_events
    from stepgap.cli.run_report import TICKS_PER_FRAME, report_run
    from stepgap.experiment.loop import run as run_experiment
    from stepgap.experiment.plants import choose_plants
    from stepgap.experiment.run_start import check_reach, dated_folder, folder_to_resume, start_folder
    from stepgap.experiment.settings import load_known, load_reference, read_experiment
    from stepgap.experiment.tick_recorder import TickRecorder
    from stepgap.robots.hopper.apex_map import ApexMap
    from stepgap.view.live import LiveView

    if not view and (host or port):
        raise InputError("--host, --port: of the page that --view shows; give --view, too")
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
    recorder = TickRecorder(TICKS_PER_FRAME)

    def on_tick(tick: "Tick") -> None:
        recorder.on_tick(tick)
        if live:
            live.on_tick(tick)

    plants = choose_plants(settings, targets, arm, folder, on_tick)
    if not resume:
        start_folder(folder, settings, targets, known)
    try:
        with terminated_as_interrupted(), live or nullcontext():
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
                    plants.measure_noise_floor,
                    plants.replays,
                    known,
                )
            with shown_count("replay", quiet) as tell:
                written = report_run(folder, tell, recorder.kept)
            _tell_and_stay(written, json, quiet, live)
    except KeyboardInterrupt:
        again = f"stepgap run --out {shlex.quote(str(folder))} --resume{' --arm' if arm else ''}"
        raise KeyboardInterrupt(f"; go on with: {again}") from None


def _tell_and_stay(report: "WrittenReport", json: bool, quiet: bool, live: "LiveView | None") -> None:
    """Says where the report is, and keeps the live page until Ctrl-C, which by now can only end that."""
    from stepgap.cli.progress import tell_event

    try:
        if json:
            tell_event("report", path=str(report.path))
        else:
            print(report.path, flush=True)
        if report.missing and not quiet:
            _warn_of_missing(report.missing)
        if live:
            live.stay()
    except KeyboardInterrupt:
        print(file=sys.stderr)


def report(folders: list[Path], /, *, out: Path | None = None) -> None:
    """Make the report of a run anew; of several runs, a page that compares them.

    Args:
        folders: Folder of the run, or of each run.
        out: HTML file of a comparison; without it comparison.html beside the first run, or the next free name.
    """
    from stepgap.cli.progress import shown_count
    from stepgap.cli.run_report import compare_runs, report_run

    if len(folders) > 1:
        page = out or free_name(folders[0].resolve().parent / "comparison.html")
        compare_runs(folders, page)
    elif out:
        raise InputError("--out: goes with several runs; the report of one lies in its folder")
    else:
        with shown_count("replay") as tell:
            page, missing = report_run(folders[0], tell)
        if missing:
            _warn_of_missing(missing)
    print(page)


def _warn_of_missing(parts: Sequence[str]) -> None:
    """Lists on stderr what a report does without."""
    say(f"left out of the report: {'; '.join(parts)}")


def _quoted(text: str | None) -> str | None:
    """The TOML of a text."""
    return None if text is None else json.dumps(text, ensure_ascii=False)
