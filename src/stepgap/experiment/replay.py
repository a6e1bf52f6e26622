"""The ticks of a recorded deployment: simulated again, or read from the tick log of a rig; the motion in them."""

import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import numpy as np

from stepgap.base.errors import InputError, StepGapWarning
from stepgap.base.files import own_folder
from stepgap.base.versions import versions_here
from stepgap.experiment.loop import deployment_generator
from stepgap.experiment.plants import simulation_of
from stepgap.experiment.run import Run
from stepgap.experiment.settings import PROCESS, Experiment
from stepgap.learning.steps import LoggedStep, Steps
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.ticks.rig_state import RigState
from stepgap.plants.ticks.stream import numbered
from stepgap.plants.ticks.tick_log import TickLogError, read_ticks
from stepgap.plants.ticks.tick_table import TickTable
from stepgap.records.missing import Missing
from stepgap.records.motion_file import INTERVAL, Replay, motion_path, read_motion, write_motion
from stepgap.records.steps_csv import RecordError, digest, row_of
from stepgap.rigs.entry_points import load_rig
from stepgap.rigs.rig import RigFault
from stepgap.robots.scene import GroundPieces, Kinematics, Motion, Scene
from stepgap.step import Array

FOOTPRINT = 0.06  # Length of the ground that is drawn where a foot stood [m]


def kinematics_of(run: Run) -> Kinematics | Missing:
    """How the robot of a run is drawn, with the sensors of its plant."""
    if isinstance(run.robot, Missing):
        return run.robot
    try:
        return find_kinematics(run.needed(run.settings))
    except InputError as error:
        return Missing(str(error))


def replay_of(run: Run) -> Replay | Missing:
    """Motions of the first and the last deployment of a run, from `replay/`, or made and written there."""
    if run.replay is not None:
        return run.replay
    kinematics = kinematics_of(run)
    if isinstance(kinematics, Missing):
        return kinematics
    try:
        return _replay_of(run, kinematics)
    except InputError as error:
        return Missing(str(error))


def _replay_of(run: Run, kinematics: Kinematics) -> Replay:
    """The same, where the kinematics is known; raises InputError if the ticks are not, or differ from the steps."""
    measured = [*kinematics.units, "step"]
    scene = kinematics.scene
    file = run.settings_file
    text = None if isinstance(file, Missing) else file.text

    def motion(iteration: int) -> Motion:
        path = motion_path(run.folder, iteration)
        steps = digest(run.recorded.of_iteration(iteration))
        origin = sha256(f"measured {INTERVAL} {scene} {iteration} {steps} {text}".encode()).hexdigest()
        kept = read_motion(path, scene, origin)
        return kept or write_motion(path, kinematics.motion(ticks(iteration).selected(measured)), origin)

    def ticks(iteration: int) -> TickTable:
        if iteration in run.ticks:
            return run.ticks[iteration]
        if run.needed(run.settings).simulated:
            return replay(run, iteration, kinematics.every(INTERVAL), run.on_replay)
        return logged_ticks(run, iteration).resampled(1 / INTERVAL)

    ends = dict.fromkeys((run.shown_iterations[0], run.shown_iterations[-1]))
    all_grounds = {iteration: ground_of(run, iteration, scene) for iteration in ends}
    grounds = {iteration: ground for iteration, ground in all_grounds.items() if ground}
    return Replay({iteration: motion(iteration) for iteration in ends}, scene, grounds)


def ground_of(run: Run, iteration: int, scene: Scene) -> GroundPieces | None:
    """The uneven ground of a deployment: that of its simulation, or else where the feet stood in its steps.

    Returns:
        Its pieces; None if states are not measured above a ground, or nothing is known of it.

    Raises:
        InputError: The simulation cannot be made.
    """
    settings = run.needed(run.settings)
    space = run.space
    if not space.is_above_context:
        return None
    if settings.simulated:
        with warnings.catch_warnings():  # what the ground lacks was said when the run began
            warnings.simplefilter("ignore", StepGapWarning)
            return simulation_of(settings).ground(deployment_generator(settings.seed, iteration))
    above = next((quantity.above for quantity in space.state if quantity.name == scene.height), "")
    if not (above and scene.foothold in space.context_names):
        return None
    columns = [space.context_names.index(name) for name in (scene.foothold, above)]
    places = run.recorded.of_iteration(iteration).context[:, columns]
    place, height = places[np.isfinite(places).all(axis=1)].T
    return GroundPieces(
        start=place - FOOTPRINT / 2,
        end=place + FOOTPRINT / 2,
        start_height=height,
        end_height=height,
        changed=np.zeros(len(place), bool),
    )


def replay(
    run: Run, iteration: int, every: int = 1, progress: Callable[[int, int], None] = lambda done, total: None
) -> TickTable:
    """The ticks of a recorded deployment of a simulated plant, simulated again from its seed and commands.

    Args:
        every: Interval of the kept ticks; 1 keeps every tick.
        progress: Called with the number of finished steps and their total number.

    Returns:
        Ticks with the columns of `Kinematics.observed_units`, which include the true state, and a column `step`.

    Raises:
        InputError: The run cannot be read, has no such deployment, was not simulated, or has no ticks.
        RecordError: The simulated steps differ from the recorded ones.
    """
    settings = run.needed(run.settings)
    steps = _steps_of(run, iteration)
    tables = list[TickTable]()
    for done, table in enumerate(_replayed_steps(run, steps, every), int(steps.unplanned[0])):
        tables.append(table)
        progress(done, len(steps))
    if not any(map(len, tables)):
        raise InputError(f"plant '{settings.plant}': reports no ticks, so the motion between the steps is unknown")
    return TickTable(tables[0].units, np.concatenate([table.rows for table in tables]))


def replayed_steps(run: Run, iteration: int, every: int = 1) -> Iterator[TickTable]:
    """Yields the ticks of `replay` step by step as they are simulated; the first ones are those of the start."""
    return _replayed_steps(run, _steps_of(run, iteration), every)


def find_kinematics(settings: Experiment) -> Kinematics | Missing:
    """Kinematics of the robot of an experiment, or the reason why its motion is not known; builds no plant.

    Raises:
        InputError: The rig, or the file that describes it, does not exist.
    """
    if settings.plant == PROCESS:
        return Missing(f"plant '{settings.plant}': the motion between the steps is not recorded")
    sensors = None
    if not settings.simulated:
        sensors = load_rig(settings.plant, Path(settings.rig), settings.robot).sensor_model
    kinematics = settings.robot.kinematics(sensors)
    return kinematics or Missing(f"robot '{settings.robot.name}' has no kinematics, so its motion is not drawn")


def tick_units_of(settings: Experiment) -> Mapping[str, str]:
    """Columns of the ticks of a simulated deployment, as `replay` returns them, with their units.

    Raises:
        InputError: The motion of this plant is not known.
    """
    kinematics = find_kinematics(settings)
    if isinstance(kinematics, Missing):
        raise InputError(kinematics.reason)
    return {**kinematics.observed_units, "step": ""}


def logged_ticks(run: Run, iteration: int) -> TickTable:
    """Reads the ticks of a rig's deployment from its log, with a column `step`; only ticks with sensor values are kept.

    They begin when torque is given, and end with the last step or, if it failed, when the robot is at rest. The ends of
    steps are those that the robot's control detects; step 0 is the one after the release.

    Raises:
        InputError: The run has no such deployment, or the log does not exist, is incomplete, or has fewer steps.
    """
    robot = run.needed(run.robot)
    recorded = _steps_of(run, iteration)
    steps = recorded.planned()
    path = own_folder(run.folder, "ticks") / f"ticks-{iteration}.mcap"
    control = robot.control()
    if control is None:
        raise InputError(f"robot '{robot.name}' has no control for a rig, so its ticks cannot be read")
    try:
        ticks = TickTable(*read_ticks(path))
        ends = control.step_ends(ticks)
        ends = ends[ticks["state"][ends] == RigState.STEP]
    except (TickLogError, ValueError) as error:
        raise InputError(str(error)) from None
    step = np.searchsorted(ends, np.arange(len(ticks)))  # the tick that ends a step belongs to it
    if len(ends) < len(steps):
        raise InputError(f"{path}: has fewer steps than deployment {iteration}, so ticks and steps cannot be matched")
    kept = (ticks["state"] >= RigState.STAND) & (step <= len(steps)) & np.isfinite(ticks.rows).all(axis=1)
    numbers = (step + int(recorded.number[0]) - 1 + int(recorded.unplanned[0])).astype(float)
    return TickTable({**ticks.units, "step": ""}, np.column_stack([ticks.rows, numbers])[kept])


def _steps_of(run: Run, iteration: int) -> Steps:
    """The steps of a deployment, at least one."""
    steps = run.recorded.of_iteration(iteration)
    if not len(steps):
        there = ", ".join(map(str, run.recorded.iterations)) or "none"
        raise InputError(
            f"{run.folder / 'steps.csv'}: no step of deployment {iteration}; recorded deployments: {there}"
        )
    return steps


def _replayed_steps(run: Run, steps: Steps, every: int) -> Iterator[TickTable]:
    """Yields the ticks of each step after a check that the step equals the recorded one."""
    settings = run.needed(run.settings)
    if not settings.simulated:
        raise InputError(
            f"plant '{settings.plant}': a deployment of a rig cannot be simulated again; its ticks are in ticks/"
        )
    units = tick_units_of(settings)
    rows = list[Array]()
    first, *_ = steps
    before = first.step - 1 + int(steps.unplanned[0])  # number of the step that the plant takes when it starts

    def on_ticks(ticks: Rows, step: int) -> None:
        rows.extend(numbered(ticks, before + step))

    def drained() -> TickTable:
        table = TickTable(units, np.array(rows, float).reshape(len(rows), len(units)))
        rows.clear()
        return table

    rng = deployment_generator(settings.seed, first.iteration)
    with simulation_of(settings).observed_plant(rng, on_ticks, every) as plant:
        try:
            plant.start()
        except RigFault as fault:
            raise RecordError(f"{_mismatch(run, first)} ({fault})") from None
        if not steps.unplanned[0]:
            yield drained()
        for logged in steps:
            taken = plant.first_step if logged.step == before else plant.take_step(logged.record.command)
            simulated = replace(logged, record=taken)
            if row_of(simulated, steps.space) != row_of(logged, steps.space):
                raise RecordError(_mismatch(run, logged))
            yield drained()


def _mismatch(run: Run, logged: LoggedStep) -> str:
    """The message that a step could not be reproduced, with a possible reason."""
    here = versions_here()
    changed = [f"{name} {then}, here {here[name]}" for name, then in run.versions if here.get(name, then) != then]
    reason = (
        f"it was run with {'; '.join(changed)}" if changed else "the record was changed, or is from another machine"
    )
    step = f"step {logged.step} of deployment {logged.iteration}"
    return f"{run.folder / 'steps.csv'}: {step} could not be reproduced exactly; {reason}"
