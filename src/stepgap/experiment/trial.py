"""Short deployments of a robot before its first run: what `stepgap check` judges and `stepgap view --robot` shows."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import StepGapWarning
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.deployment import deploy
from stepgap.experiment.inputs import write_experiment
from stepgap.experiment.loop import Observer, Setup, run_experiment
from stepgap.experiment.nominal import Nominal
from stepgap.experiment.plants import PlantRequest, choose_plants
from stepgap.experiment.recorders import TickRecorder
from stepgap.experiment.replay import find_kinematics
from stepgap.experiment.run import Run
from stepgap.experiment.settings import Experiment
from stepgap.learning.learner import Learner
from stepgap.learning.steps import Steps, joined
from stepgap.plants.plant import AtTouchdown, Plant
from stepgap.records.missing import Missing
from stepgap.records.motion_file import INTERVAL
from stepgap.step import Array, StepMap, StepRecord, StepSpace


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
        on_fault=lambda message: warnings.warn(message, StepGapWarning, stacklevel=2),
    )
    run_experiment(setup, folder, recorder.observing(observer))
    return Run(folder, ticks=recorder.kept, nominal=nominal.map, space=nominal.map.space)


PROBES_PER_WEIGHT = 5  # Number of probing steps for each number that is found from them
FEWEST_PROBES = 40  # Number of probing steps, at least
MOST_DEPLOYMENTS = 6  # Number of deployments that they take at most, because the robot fails
LARGEST_PROBE = 0.5  # Largest change of a command by which it is probed [half ranges]
PROBED_MOVE = 0.4  # Largest change of a state that it has by the map [half ranges]


def probing_steps(
    settings: Experiment,
    nominal: Nominal,
    reference: Reference,
    folder: Path,
    program: Sequence[str] = (),
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Steps:
    """Steps to targets in random order whose commands differ at random from those of the nominal map.

    So each command varies by itself, which shows its effects. A robot that fails begins again.

    Args:
        reference: Targets that are held.
        folder: An empty folder.
        program: Command line of the robot's program, for the plant `process`.
        progress: Called with the numbers of finished and of all steps.

    Raises:
        InputError: No plant can be made with these settings.
    """
    space = nominal.map.space
    rng = random_stream(settings.seed, 0, 5)
    total = max(FEWEST_PROBES, PROBES_PER_WEIGHT * (1 + len(space.state) + 2 * len(space.command)))
    targets = reference.targets[reference.distinct[0]]
    sizes = probe_sizes(nominal.map, targets)
    learner = Learner.start(nominal.map, Steps(space), replace(settings.learning, residual="none", drift=False), 0)
    parts = list[Steps]()
    count = 0
    while count < total and len(parts) < MOST_DEPLOYMENTS:
        wanted = Reference(reference.names, targets[rng.integers(len(targets), size=total - count)])
        request = PlantRequest(settings, wanted, folder, program=program)
        plant = ProbedPlant(choose_plants(request).make(rng), sizes, rng)
        part = Steps(space)
        for logged in deploy(learner, plant, wanted, 0, control=settings.control):
            part += [logged]
            progress(count + len(part), total)
        count += len(part)
        parts.append(part)
    return joined(parts)


def probe_sizes(nominal: StepMap, targets: Array) -> Array:
    """Largest change of each command with which it is probed [half ranges]; shape (m,).

    Args:
        nominal: The map, which says how far a command moves the state.
        targets: States about which it is probed, NaN where there is no target; shape (k, n).
    """
    space = nominal.space
    states = np.where(np.isfinite(targets), targets, space.state_centre)
    matrices = nominal.jacobian(states, np.tile(space.command_centre, (len(states), 1)))[..., len(space.state) :]
    moves = np.abs(matrices) * space.command_scale / space.state_scale[:, None]
    largest = np.max(np.nan_to_num(moves), axis=(0, 1), initial=0.0)
    return np.minimum(LARGEST_PROBE, PROBED_MOVE / np.maximum(largest, 1e-9))


class ProbedPlant(Plant):
    """A plant each command of which is changed at random.

    Args:
        sizes: Largest changes [half ranges]; shape (m,).
    """

    def __init__(self, plant: Plant, sizes: Array, rng: np.random.Generator):
        self._plant = plant
        self._sizes = sizes
        self._rng = rng

    @property
    def space(self) -> StepSpace:
        """Names, units and ranges of the plant."""
        return self._plant.space

    @property
    def first_step(self) -> StepRecord | None:
        """That of the plant."""
        return self._plant.first_step

    def start(self) -> Array:
        """Starts the plant."""
        return self._plant.start()

    def take_step(self, command: Array) -> StepRecord:
        """Executes one step with the changed command."""
        return self._plant.take_step(self._changed(command))

    def take_replanned_step(self, command: Array, at_touchdown: AtTouchdown) -> StepRecord:
        """Executes one step with the changed command, also of its touchdown."""
        return self._plant.take_replanned_step(
            self._changed(command), lambda touchdown: self._changed(at_touchdown(touchdown))
        )

    def stop(self) -> None:
        """Stops the plant."""
        self._plant.stop()

    def _changed(self, command: Array) -> Array:
        return self.space.command_at(self.space.point_of(command) + self._rng.uniform(-self._sizes, self._sizes))
