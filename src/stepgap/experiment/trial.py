"""A short deployment of a robot before its first run: what `stepgap check` judges and `stepgap view --robot` shows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from stepgap.control.reference import Reference
from stepgap.experiment.inputs import write_experiment
from stepgap.experiment.loop import Observer, Setup, run_experiment
from stepgap.experiment.nominal import Nominal
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.recorders import TickRecorder
from stepgap.experiment.replay import find_kinematics
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.records.missing import Missing
from stepgap.records.motion_file import INTERVAL


def trial_run(
    settings: Experiment,
    nominal: Nominal,
    reference: Reference,
    folder: Path,
    program: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Run:
    """Runs one deployment with the nominal map, and measures the noise floor.

    Args:
        settings: Settings of the experiment.
        nominal: Its nominal map.
        reference: Targets of all steps.
        folder: An empty folder for the record.
        program: Command line of the robot's program, for the plant `process`.
        progress: Called with the numbers of finished and of all steps, then of targets at which a step is repeated.

    Raises:
        InputError: No plant can be made with these settings.
    """
    settings = replace(settings, learning=replace(settings.learning, iterations=0, exploration=0, online=False))
    kinematics = find_kinematics(settings)
    drawn = not isinstance(kinematics, Missing)
    recorder = TickRecorder(kinematics.units if drawn else {}, kinematics.every(INTERVAL) if drawn else 1)
    request = PlantRequest(settings, reference, folder, on_ticks=recorder.on_ticks, program=program)
    setup = Setup(nominal.map, choose_plants(request), reference, settings.learning, settings.control, settings.seed)
    write_experiment(folder, settings, reference, surrogate=nominal.file)
    observer = Observer(
        on_step=lambda logged: progress(logged.step, len(reference)),
        on_phase=lambda name, done, total: progress(done, total),
    )
    run_experiment(setup, folder, recorder.observing(observer))
    return Run(folder, ticks=recorder.kept, nominal=nominal.map)
