"""The verb `stepgap check`."""

import shutil
import sys
import textwrap
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from stepgap.base.errors import InputError
from stepgap.base.output_files import check_new, free_name
from stepgap.cli.nominal import kept_reference, kept_surrogate, nominal_with_progress
from stepgap.cli.options import FileName, Flag, Name, Overrides, Program
from stepgap.cli.terminal import announces_compilation, warn

if TYPE_CHECKING:  # slow imports are made where they are used
    from stepgap.control.reference import Reference
    from stepgap.experiment.nominal import Nominal
    from stepgap.experiment.settings import Experiment
    from stepgap.report.robot_check import PartResult

_WRONG = 1  # Exit code if a part of the robot is wrong

_LONG = 30  # CPU time of a check [s] that is said at its end


@announces_compilation
def check_robot(
    robot: Annotated[str | None, Parameter(metavar="ROBOT")] = None,
    /,
    *,
    reference: FileName | None = None,
    plant: Name | None = None,
    out: Path | None = None,
    no_random: Flag = False,
    overrides: Overrides = None,
    program: Program = None,
) -> None:
    """Test the parts of a robot before its first run, from its map to the noise of its steps, and draw 20 steps.

    Each part, printed as soon as it is tested, is ok, wrong, or left out where the robot does not have it. The exit
    code is 1 if a part is wrong.

    Args:
        robot: Name of the robot, or a TOML file of settings. [default: hopper]
        reference: CSV file of targets. [default: the robot's reference]
        plant: Simulated plant of the robot, or process (the program given after two dashes). [default: the first
            simulation]
        out: New file for the picture of the steps. [default: check.png or the next free name]
        no_random: Give no random commands, for a machine that must not get any: what shows by the steps to the targets
            alone is judged.
    """
    if out:
        check_new(out, "--out")
    settings = _settings(robot, {"reference": reference, "plant": plant}, overrides or [])
    begin = process_time()
    wrong = False
    for result in results_of_robot(settings, out, program or [], probing=not no_random):
        print(_row(result), flush=True)
        wrong |= result.verdict == "wrong"
    if (taken := process_time() - begin) > _LONG:
        warn(f"this check took {taken:.0f} s of CPU time")
    if wrong:
        sys.exit(_WRONG)


def results_of_robot(
    settings: "Experiment", out: Path | None, program: Sequence[str], *, probing: bool = True
) -> "Iterator[PartResult]":
    """Yields the results for all parts of a robot, as soon as they are known, in the order in which to mend them.

    Args:
        settings: Settings of an experiment with it.
        out: New file for the picture of its steps; None for the next free name.
        program: Command line of the robot's program, for the plant `process`.
        probing: Whether some steps have commands that vary at random.
    """
    from stepgap.report.robot_check import PartResult, check_placing, results_of

    yield from results_of("placing", check_placing(settings.robot, settings.seed))
    try:
        nominal = nominal_with_progress(settings)
    except InputError as error:
        yield PartResult("map", "wrong", f"{error}. Without a map, the parts that need one are left out.")
        return
    wrong = False
    for result in _of_map(settings, nominal):
        yield result
        wrong |= result.verdict == "wrong"
    if wrong:
        yield PartResult("others", "left out", "Mend the map first: all other parts need it.")
        return
    yield from _of_motion(settings, nominal, out, program, probing)
    if path := kept_surrogate(nominal):
        warn(f"the simulated steps are kept: --nominal.file {path}")


def _settings(robot: str | None, given: "dict[str, str | None]", overrides: Sequence[tuple[str, str]]) -> "Experiment":
    """The settings of a robot by its name, or of a file."""
    from stepgap.experiment.settings import read_experiment
    from stepgap.records.steps_csv import check_names

    file = Path(robot) if robot and robot.endswith(".toml") else None
    named = [("robot", robot)] if robot and not file else []
    if named and "robot" in dict(overrides):
        raise InputError(f"{robot}, --robot: give the name of the robot only once")
    changes = [*named, *overrides, *((name, value) for name, value in given.items() if value)]
    settings = read_experiment(file, changes)
    check_names(settings.robot.space)
    return settings


def _of_map(settings: "Experiment", nominal: "Nominal") -> "Iterator[PartResult]":
    """The results on the nominal map alone."""
    from stepgap.base.random_streams import random_stream
    from stepgap.report.map_check import check_jacobian, check_map, check_smooth
    from stepgap.report.robot_check import results_of

    rng = random_stream(settings.seed, 0, 6)
    results = results_of("map", check_map(nominal.map, rng))
    yield from results
    if all(result.verdict != "wrong" for result in results):
        smooth = results_of("smooth", check_smooth(nominal.map, rng))
        yield from results_of("jacobian", check_jacobian(nominal.map, rng))
        yield from smooth


def _of_motion(
    settings: "Experiment", nominal: "Nominal", out: Path | None, program: Sequence[str], probing: bool
) -> "Iterator[PartResult]":
    """The results on what the robot shall do, and on what it does in some steps, which are drawn."""
    from stepgap.control.limit_cycle import held_reference
    from stepgap.experiment.inputs import load_reference, trial_reference
    from stepgap.experiment.settings import PROCESS
    from stepgap.report.map_check import check_authority
    from stepgap.report.robot_check import PartResult, check_commands, check_targets, results_of

    reference = load_reference(settings, nominal.map.space)
    held = held_reference(nominal.map, reference)
    file = kept_reference(held) if held and held is not reference else None
    yield from results_of("targets", check_targets(nominal.map, reference, held is not None, file))
    if held is None:
        yield PartResult("motion", "left out", "Without a target that is held, there is nothing to do.")
        return
    yield from results_of("commands", check_commands(nominal.map, held))
    yield from results_of("authority", check_authority(nominal.map, held))
    if not settings.simulated and not (settings.plant == PROCESS and program):
        text = f"Plant '{settings.plant}' is no simulation. Give the program of the robot after two dashes, or a plant."
        yield PartResult("motion", "left out", text)
        return
    for finding in settings.robot.findings() if settings.simulated else ():
        yield PartResult(finding.part, "ok" if finding.right else "wrong", finding.sentence)
    yield from _of_trial(settings, nominal, trial_reference(settings, held), out, program, probing)


def _of_trial(
    settings: "Experiment",
    nominal: "Nominal",
    targets: "Reference",
    out: Path | None,
    program: Sequence[str],
    probing: bool,
) -> "Iterator[PartResult]":
    from stepgap.cli.progress import progress_bar
    from stepgap.experiment.replay import kinematics_of
    from stepgap.experiment.trial import probing_steps, trial_run
    from stepgap.learning.steps import Steps
    from stepgap.report.drawing import write_picture
    from stepgap.report.robot_check import check_robot_steps, check_section, results_of
    from stepgap.report.trial_figure import trial_figure

    with TemporaryDirectory() as folder, TemporaryDirectory() as other:
        with progress_bar("steps") as progress:
            run = trial_run(settings, nominal, targets, Path(folder), program, progress)
            probes = Steps(run.steps.space)
            if probing:
                probes = probing_steps(settings, nominal, targets, Path(other), program, progress)
        yield from results_of("motion", check_robot_steps(run, probes))
        yield from results_of("section", check_section(run.ticks.get(0)))
        write_picture(out or free_name(Path("check.png")), lambda: trial_figure(run, kinematics_of(run)))


def _row(result: "PartResult") -> str:
    """A result as lines that fit the terminal."""
    return textwrap.fill(
        result.sentence,
        max(60, shutil.get_terminal_size((110, 24)).columns),
        initial_indent=f"{result.part:10}{result.verdict:10}",
        subsequent_indent=" " * 20,
        break_on_hyphens=False,
    )
