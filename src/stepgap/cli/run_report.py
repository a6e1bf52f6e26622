"""The report of a run with its context: its settings, its nominal map and its motions."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from stepgap.base.blas import one_blas_thread
from stepgap.base.errors import InputError, message_of
from stepgap.base.files import create
from stepgap.base.output_files import check_new, writing
from stepgap.experiment.inputs import load_known, read_run, recorded_robot, robot_of_steps
from stepgap.experiment.loaded_run import LoadedRun
from stepgap.experiment.nominal import load_nominal
from stepgap.experiment.replay import find_kinematics, logged_ticks, replay
from stepgap.experiment.settings import Experiment, experiment_table, read_experiment
from stepgap.learning.residual import Residual
from stepgap.learning.steps import as_past
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.missing import Missing
from stepgap.records.run_folder import RunRecord
from stepgap.records.steps_csv import RecordError
from stepgap.report import RunContext, WrittenReport, comparison_html, write_report
from stepgap.report.motion import INTERVAL, Replay, kept_motion
from stepgap.robots.entry_points import load_robot
from stepgap.robots.scene import Motion
from stepgap.step import StepMap


def report_run(
    folder: Path,
    progress: Callable[[int, int], None] = lambda done, total: None,
    recorded: Mapping[int, TickTable] | None = None,
) -> WrittenReport:
    """Writes the report of a run with all available information.

    The replay is kept in `replay/` of the run folder.

    Args:
        folder: The run folder.
        progress: Called with the numbers of finished and of all steps while a deployment is simulated again.
        recorded: Ticks of deployments, one for every frame, as kept by a `TickRecorder` during the run.

    Raises:
        InputError: The content of a file is wrong, or the report cannot be written.
    """
    try:
        settings = _settings_of(folder)
        record = read_run(folder, None if isinstance(settings, Missing) else robot_of_steps(folder, settings))
        return write_report(record, _context(record, settings, progress, recorded or {}))
    except (ValueError, OSError) as error:
        raise InputError(message_of(error)) from None


def compare_runs(folders: Sequence[Path], page: Path) -> None:
    """Writes one page that compares several runs.

    Args:
        folders: The run folders.
        page: File to write, which must not exist.

    Raises:
        InputError: A run cannot be read or compared, or the page cannot be written.
    """
    check_new(page, "--out")
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise InputError("a run is given twice; give each run once")
    try:
        text = comparison_html([read_run(folder, recorded_robot(folder)) for folder in folders])
    except (ValueError, OSError) as error:
        raise InputError(message_of(error)) from None
    with writing(page, "--out"):
        create(page, text)


def _context(
    record: RunRecord,
    settings: Experiment | Missing,
    progress: Callable[[int, int], None],
    recorded: Mapping[int, TickTable],
) -> RunContext:
    """Context of the report from the settings of a run, with the reason for each missing part."""
    if isinstance(settings, Missing):
        return RunContext("plant of an unknown kind", settings, settings, settings, settings)
    plant = settings.robot.plant_titles.get(settings.plant, f"plant '{settings.plant}'")
    defaults = experiment_table(Experiment(load_robot(settings.robot.name)))
    nominal = _nominal_of(settings)
    final = nominal if isinstance(nominal, Missing) else _final_residual(record, settings, nominal)
    return RunContext(plant, defaults, nominal, _replay(record, settings, progress, recorded), final)


def _settings_of(folder: Path) -> Experiment | Missing:
    if not (folder / "experiment.toml").exists():
        return Missing("the folder contains no experiment.toml")
    try:
        return read_experiment(folder / "experiment.toml")
    except InputError as error:
        return Missing(f"the settings are not valid in this version: {error}")


def _nominal_of(settings: Experiment) -> StepMap | Missing:
    try:
        return load_nominal(settings).map
    except InputError as error:
        return Missing(str(error))


def _final_residual(record: RunRecord, settings: Experiment, nominal: StepMap) -> Residual | Missing:
    """Residual after deployment 0 if it learned from the nominal map on, as a next deployment would begin with it."""
    if not record.has_unsaved_residual:
        return Missing("the residual at the start of the last deployment is described")
    try:
        known = as_past(load_known(settings, nominal.space))
        with one_blas_thread():
            return LoadedRun(record.folder, settings, nominal, record.steps, known).learner(1).residual
    except InputError as error:
        return Missing(str(error))


def _replay(
    record: RunRecord,
    settings: Experiment,
    progress: Callable[[int, int], None],
    recorded: Mapping[int, TickTable],
) -> Replay | Missing:
    """Motions of the first and the last deployment, or the reason why there are none."""
    ends = dict.fromkeys((record.shown_iterations[0], record.shown_iterations[-1]))
    try:
        kinematics = find_kinematics(settings)
        if isinstance(kinematics, Missing):
            return kinematics
        measured, scene = [*kinematics.units, "step"], kinematics.scene

        def motion(iteration: int) -> Motion:
            if iteration in recorded:
                ticks = recorded[iteration]
            elif settings.simulated:
                ticks = replay(record.folder, iteration, kinematics.every(INTERVAL), progress)
            else:
                steps = record.steps.of_iteration(iteration)
                ticks = logged_ticks(record.folder, steps, settings).resampled(1 / INTERVAL)
            return kinematics.motion(ticks.selected(measured))

        return Replay({iteration: kept_motion(record, scene, iteration, motion) for iteration in ends}, scene)
    except (InputError, RecordError) as error:
        return Missing(str(error))
