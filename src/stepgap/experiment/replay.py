"""The ticks of a recorded deployment: simulated again, or read from the tick log of a rig."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.versions import versions_here
from stepgap.experiment.loop import deployment_generator
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.settings import PROCESS, Experiment, read_experiment
from stepgap.learning.step_log import LoggedStep
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.realtime.states import RigState
from stepgap.plants.rig_plant import RigPlant
from stepgap.plants.ticks.tick_log import TickLogError, read_ticks
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.steps_csv import RecordError, read_step_log, row_of
from stepgap.records.summary import read_summary
from stepgap.rigs.entry_points import load_rig
from stepgap.rigs.limits import RigLimits
from stepgap.rigs.rig import Health, Reading, Rig, RigFault, SensorModel, Torques
from stepgap.robots.hopper.hop_control import sensors_of
from stepgap.robots.hopper.phases import Phase
from stepgap.robots.hopper.robot import as_hopper
from stepgap.robots.hopper.sensors import HopperSensorModel
from stepgap.robots.hopper.simulation import HopperSimulation
from stepgap.robots.hopper.tick import TICK_UNITS
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin.twin_sensors import twin_sensor_model
from stepgap.step import Array

REPLAY_UNITS = {
    **TICK_UNITS,
    "step": "",
    "hip_x": "m",
    "hip_height": "m",
    "boom_yaw": "rad",
    "boom_pitch": "rad",
    "true_alpha_1": "rad",
    "true_alpha_2": "rad",
    "foot_x": "m",
    "foot_y": "m",
    "foot_z": "m",
    "ground_height": "m",
}
"""Columns of a replay: those of a tick, the number of its step, and the true state of the twin at the reading.

The hip's x is the distance travelled along the circle; the foot is in MuJoCo's frame, whose z points up from the floor.
The step before the first recorded one is the hop after the release.
"""


def replay(
    folder: Path, iteration: int, every: int = 1, progress: Callable[[int, int], None] = lambda done, total: None
) -> TickTable:
    """The ticks of a recorded deployment on the twin or an emulated ring, simulated again from its seed and commands.

    Args:
        folder: The run folder.
        iteration: Number of the deployment.
        every: Interval of the kept ticks; 1 keeps every tick.
        progress: Called with the number of finished steps and their total number.

    Raises:
        InputError: The run cannot be read, has no such deployment, or was not simulated.
        RecordError: The simulated steps differ from the recorded ones.
    """
    experiment, steps = _read(folder, iteration)
    rows = []
    for done, ticks in enumerate(_hops(folder, experiment, steps, every)):
        rows.append(ticks)
        progress(done, len(steps))
    return TickTable(REPLAY_UNITS, np.concatenate(rows))


def replayed_hops(folder: Path, iteration: int, every: int = 1) -> Iterator[TickTable]:
    """Yields the ticks of `replay` hop by hop as they are simulated; the first hop is the one after the release."""
    for ticks in _hops(folder, *_read(folder, iteration), every):
        yield TickTable(REPLAY_UNITS, ticks)


def sensor_model_of(settings: Experiment) -> HopperSensorModel:
    """Sensor model of the ticks of an experiment; builds no twin.

    Raises:
        InputError: The rig, or the file that describes it, does not exist.
    """
    if settings.plant == PROCESS:
        raise InputError(f"plant '{PROCESS}': the motion between the steps is not recorded")
    hopper = as_hopper(settings.robot, "the motion between the steps is shown")
    if settings.simulated:
        return twin_sensor_model(hopper.parameters, hopper.gap)
    return sensors_of(load_rig(settings.plant, Path(settings.rig), hopper))


def logged_ticks(folder: Path, steps: Sequence[LoggedStep]) -> TickTable:
    """Reads the ticks of a rig's deployment from its log, with a column `step`; only ticks with sensor values are kept.

    They begin when torque is given, and end with the last step or, after a fall, when the robot is at rest. The apexes
    that were passed while the robot hopped separate the steps; step 0 is the hop after the release.

    Args:
        folder: The run folder.
        steps: Steps of the deployment, at least one.

    Raises:
        InputError: The log does not exist, is incomplete, or has fewer hops than the deployment.
    """
    path = folder / "ticks" / f"ticks-{steps[0].iteration}.mcap"
    try:
        ticks = TickTable(*read_ticks(path))
        phase, hopping = ticks["phase"], ticks["state"] == RigState.HOP
    except (TickLogError, ValueError) as error:
        raise InputError(str(error)) from None
    passed = np.flatnonzero((phase[:-1] == Phase.ASCENT) & (phase[1:] == Phase.DESCENT) & hopping[1:]) + 1
    hop = np.searchsorted(passed, np.arange(len(ticks)))  # the tick just past an apex ends its hop
    if len(passed) < len(steps):
        number = steps[0].iteration
        raise InputError(f"{path}: has fewer hops than deployment {number}, so hops and steps cannot be matched")
    kept = (ticks["state"] >= RigState.STAND) & (hop <= len(steps)) & np.isfinite(ticks.rows).all(axis=1)
    step = (hop + steps[0].step - 1).astype(float)
    return TickTable({**ticks.units, "step": ""}, np.column_stack([ticks.rows, step])[kept])


def replay_rig(settings: Experiment, iteration: int) -> tuple[Rig, Twin]:
    """Rig of a recorded deployment, in its state before the first hop, and the twin in it.

    Raises:
        InputError: The plant was not simulated, or no twin can be made with the settings.
    """
    if not settings.simulated:
        raise InputError(
            f"plant '{settings.plant}': a deployment of a rig cannot be simulated again; its ticks are in ticks/"
        )
    simulation = simulation_of(settings)
    if not isinstance(simulation, HopperSimulation):
        raise InputError(f"robot '{settings.robot.name}': its motion between the steps is not simulated again")
    return simulation.direct_rig(deployment_generator(settings.seed, iteration))


def _read(folder: Path, iteration: int) -> tuple[Experiment, list[LoggedStep]]:
    """Reads the settings of a run and the steps of one of its deployments."""
    settings, path = read_experiment(folder / "experiment.toml"), folder / "steps.csv"
    try:
        log = read_step_log(path, settings.robot.space)
    except OSError as error:
        raise InputError(f"{path}: {error.strerror}; {folder} must be the folder of a run") from None
    steps = list(log.of_iteration(iteration))
    if not steps:
        there = ", ".join(map(str, log.iterations)) or "none"
        raise InputError(f"{path}: no step of deployment {iteration}; recorded deployments: {there}")
    return settings, steps


def _hops(folder: Path, settings: Experiment, steps: list[LoggedStep], every: int) -> Iterator[Array]:
    """Yields the rows of each hop after a check that its step equals the recorded one."""
    rig, twin = replay_rig(settings, steps[0].iteration)
    recorder = _Recorder(twin, every)
    control = as_hopper(settings.robot, "a deployment is simulated again").control()
    with RigPlant(_ObservedRig(rig, recorder.on_read), control, recorder.on_ticks) as plant:
        recorder.step = steps[0].step - 1
        try:
            plant.start()
        except RigFault as fault:
            raise RecordError(f"{_mismatch(folder, steps[0], plant.space.state_names)} ({fault})") from None
        yield recorder.drain()
        for logged in steps:
            recorder.step = logged.step
            simulated = replace(logged, record=plant.take_step(logged.record.command))
            if row_of(simulated) != row_of(logged):
                raise RecordError(_mismatch(folder, logged, plant.space.state_names))
            yield recorder.drain()


def _mismatch(folder: Path, logged: LoggedStep, names: tuple[str, ...]) -> str:
    """The message that a step could not be reproduced, with a possible reason."""
    here = versions_here()
    try:
        recorded = read_summary(folder / "summary.json", names).versions
    except (ValueError, OSError):
        recorded = ()
    changed = [f"{name} {then}, here {here[name]}" for name, then in recorded if here.get(name, then) != then]
    reason = (
        f"it was run with {'; '.join(changed)}" if changed else "the record was changed, or is from another machine"
    )
    step = f"step {logged.step} of deployment {logged.iteration}"
    return f"{folder / 'steps.csv'}: {step} could not be reproduced exactly; {reason}"


class _Recorder:
    """Keeps ticks together with the true state at the reading of their sensors.

    Attributes:
        step: Number of the step that is being executed.
    """

    def __init__(self, twin: Twin, every: int):
        self.step = 0
        self._twin, self._every, self._count = twin, every, 0
        self._truth: tuple[float, ...] = ()
        self._rows: list[tuple[float, ...]] = []

    def on_read(self) -> None:
        """Called after the sensors were read."""
        if self._count % self._every == 0:
            self._truth = _truth(self._twin)

    def on_ticks(self, rows: Rows) -> None:
        """Called at the end of every tick, because an observed rig is not run in compiled code."""
        for row in rows:
            if self._count % self._every == 0:
                self._rows.append((*row, self.step, *self._truth))
            self._count += 1

    def drain(self) -> Array:
        """Returns and forgets the rows since the last call; shape (k, columns)."""
        rows, self._rows = self._rows, []
        return np.array(rows, float).reshape(len(rows), len(REPLAY_UNITS))


def _truth(twin: Twin) -> tuple[float, ...]:
    """The true state, for the last columns of a row."""
    true = twin.true_state()
    front, rear = true.leg
    return (*true.hip, *true.boom, (front + rear) / 2, (front - rear) / 2, *true.foot, true.ground_height)


class _ObservedRig(Rig):
    """A rig that reports every reading.

    Args:
        rig: The rig.
        on_read: Called after every reading.
    """

    def __init__(self, rig: Rig, on_read: Callable[[], None]):
        self._rig, self._on_read = rig, on_read

    @property
    def sensor_model(self) -> SensorModel:
        return self._rig.sensor_model

    @property
    def limits(self) -> RigLimits | None:
        return self._rig.limits

    @property
    def health(self) -> Health:
        return self._rig.health

    @property
    def truth(self) -> tuple[float, ...]:
        return self._rig.truth

    def connect(self) -> None:
        self._rig.connect()

    def read(self) -> Reading:
        reading = self._rig.read()
        self._on_read()
        return reading

    def write(self, torques: Torques) -> Torques:
        return self._rig.write(torques)

    def close(self) -> None:
        self._rig.close()
