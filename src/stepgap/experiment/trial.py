"""A short deployment of a robot before its first run: what `stepgap check` judges and `stepgap view --robot` shows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.command_response import FEWEST_STEPS_PER_WEIGHT
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
    known = not isinstance(kinematics, Missing)
    recorder = TickRecorder(kinematics.units if known else {}, kinematics.every(INTERVAL) if known else 1)
    request = PlantRequest(settings, reference, folder, on_ticks=recorder.on_ticks, program=program)
    setup = Setup(nominal.map, choose_plants(request), reference, settings.learning, settings.control, settings.seed)
    write_experiment(folder, settings, reference, surrogate=nominal.file)
    observer = Observer(
        on_step=lambda logged: progress(logged.step, len(reference)),
        on_phase=lambda name, done, total: progress(done, total),
    )
    run_experiment(setup, folder, recorder.observing(observer))
    return Run(folder, ticks=recorder.kept, nominal=nominal.map)


TRIAL_STEPS = 20  # Number of steps of a trial that are drawn
LONGEST_HELD = 3  # Largest number of steps for which a trial holds a target


def trial_reference(settings: Experiment, held: Reference) -> Reference:
    """The targets of a reference in random order, each for one to `LONGEST_HELD` steps.

    There are at least `TRIAL_STEPS` of them, and as many as `command_response` needs.
    """
    targets = held.targets[held.distinct[0]]
    rng = random_stream(settings.seed, 0, 3)
    weights = 1 + len(settings.robot.space.state) + 2 * len(settings.robot.space.command)
    steps = max(TRIAL_STEPS, 1 + FEWEST_STEPS_PER_WEIGHT * weights)
    numbers = np.repeat(rng.integers(len(targets), size=steps), rng.integers(1, LONGEST_HELD + 1, size=steps))
    return Reference(held.names, targets[numbers[:steps]])
