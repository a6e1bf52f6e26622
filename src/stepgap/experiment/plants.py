"""Plants of `stepgap run`: a simulated plant of the robot, another program, or a rig by name."""

import re
import shutil
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.loop import MeasureNoiseFloor
from stepgap.experiment.noise_floor import measure_noise_floor
from stepgap.experiment.settings import PROCESS, Experiment
from stepgap.plants.commissioning.check import checked
from stepgap.plants.commissioning.jog import JOG
from stepgap.plants.commissioning.proof import proven
from stepgap.plants.plant import Plant
from stepgap.plants.process.line_channel import Child, Connection
from stepgap.plants.process.process_plant import ProcessPlant
from stepgap.plants.realtime.consent import supervised
from stepgap.plants.realtime.loop import LoopSettings
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.realtime_plant import RealtimePlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.records.summary import NoiseFloor
from stepgap.rigs.entry_points import load_rig, rig_names
from stepgap.rigs.limits import RigLimits
from stepgap.robots.robot import Simulation
from stepgap.step import StepMap

LARGEST_PORT = 65535
"""Largest TCP port."""


class Plants(NamedTuple):
    """Functions that make and measure the plants of a run.

    Attributes:
        make: Makes the plant of one deployment from its random generator.
        replays: Whether the same generator gives the same steps again.
        measure_noise_floor: Measures the noise floor; None where that is not possible.
    """

    make: Callable[[np.random.Generator], Plant]
    replays: bool
    measure_noise_floor: MeasureNoiseFloor | None = None


def choose_plants(
    settings: Experiment,
    reference: Reference,
    arm: bool,
    folder: Path,
    on_ticks: OnTicks | None = None,
    program: Sequence[str] = (),
) -> Plants:
    """Chooses the plants of an experiment.

    Args:
        settings: Settings, which name and describe the plant.
        reference: Reference that will be tracked.
        arm: Whether a person allows torque on a rig.
        folder: Folder of the run, into which a rig's ticks are written.
        on_ticks: Called with the ticks of a simulation, if it has any.
        program: Command line of the program of the plant `process`, or `tcp:PORT`, where it listens.

    Raises:
        InputError: No plant can be made with these settings.
    """
    if (settings.simulated or settings.plant == PROCESS) and (arm or settings.rig):
        raise InputError(f"--arm, --rig: only for real rigs; plant '{settings.plant}' takes neither")
    if settings.plant == PROCESS:
        return _of_process(settings, program)
    if program:
        raise InputError(f"-- {program[0]}: plant '{settings.plant}' runs no program; add --plant {PROCESS}")
    if not settings.simulated:
        return _of_rig(settings, arm, folder / "ticks")
    simulation = simulation_of(settings)

    def measure(step_map: StepMap, rng: np.random.Generator, progress: Callable[[int, int], None]) -> NoiseFloor:
        plant = simulation.repeatable_plant(rng)
        unknown = NoiseFloor.unknown(len(step_map.space.state))
        return measure_noise_floor(plant, step_map, reference, rng, progress) if plant else unknown

    return Plants(lambda rng: simulation.plant(rng, on_ticks), True, measure)


def simulation_of(settings: Experiment) -> Simulation:
    """The simulated plant of an experiment; the seed of the experiment draws its world.

    Raises:
        InputError: It cannot be made with these settings.
    """
    return settings.robot.simulations()[settings.plant](random_stream(settings.seed))


def _of_rig(settings: Experiment, arm: bool, logs: Path) -> Plants:
    if not settings.rig:
        plants = (*settings.robot.simulations(), PROCESS, *rig_names())
        if settings.plant not in plants:
            raise InputError(f"--plant {settings.plant}: unknown; it must be one of {', '.join(plants)}")
        raise InputError(f"--plant {settings.plant}: give the rig's file by --rig RIG.toml")
    control = settings.robot.control()
    if control is None:
        raise InputError(f"--plant {settings.plant}: robot '{settings.robot.name}' has no control for a rig")
    make_rig = partial(load_rig, settings.plant, Path(settings.rig), settings.robot)
    limits = make_rig().limits  # reports errors before the first deployment
    if not arm:
        raise InputError(
            f"--plant {settings.plant}: gives torque only with --arm; `stepgap rig dry-run` tests all but torque"
        )
    simulated = require_limits(settings.rig, limits).simulated
    loop, consent = supervised(LoopSettings(), control.consent_request, simulated)
    setup = RealtimeSetup(make_rig, control, loop)

    def require_proofs() -> None:
        checked(Path(settings.rig))
        if not simulated:
            proven(Path(settings.rig), JOG)

    def make(_: np.random.Generator) -> Plant:
        require_proofs()  # every deployment reads the files again
        return RealtimePlant(setup, logs, consent, Path(settings.rig).read_text("utf-8"))

    require_proofs()
    return Plants(make, replays=False)


def require_limits(rig: str, limits: RigLimits | None) -> RigLimits:
    """Returns the limits of a rig, after ensuring that all of them limit something.

    Raises:
        InputError: One of them does not, or there are none.
    """
    if limits is None:
        raise InputError(f"{rig}: the rig has no limits; torque needs a rig whose `limits` are all finite")
    if lacking := limits.without_effect():
        raise InputError(
            f"{rig}: [limits] lacks {', '.join(lacking)}; torque needs a finite value of each, as in examples/rig.toml"
        )
    return limits


def _of_process(settings: Experiment, program: Sequence[str]) -> Plants:
    if not program:
        example = f"stepgap run --plant {PROCESS} -- ./robot, or -- tcp:5555 if it listens on that port"
        raise InputError(f"--plant {PROCESS}: give the robot's program after two dashes: {example}")
    port = re.fullmatch(r"tcp:(\d{1,5})", program[0]) if len(program) == 1 else None
    if port and not 0 < int(port[1]) <= LARGEST_PORT:
        raise InputError(f"-- {program[0]}: there is no such port; it must be 1 to {LARGEST_PORT}")
    if not port and shutil.which(program[0]) is None:
        raise InputError(f"-- {program[0]}: cannot be started: no such program; give its path, or a name in PATH")
    connect = partial(Connection, int(port[1])) if port else partial(Child, tuple(program))
    space = settings.robot.space
    return Plants(lambda _: ProcessPlant(connect, space, settings.process), replays=False)
