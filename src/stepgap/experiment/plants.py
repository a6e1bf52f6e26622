"""Plants of a run: a simulated plant of the robot, another program, a rig by name, or one of a plug-in."""

import re
import shutil
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from stepgap.base.compiled import cache_folder
from stepgap.base.compiling import on_compilation
from stepgap.base.errors import InputError
from stepgap.base.plugins import load_plugin, plugin_names
from stepgap.base.random_streams import random_stream
from stepgap.base.start_method import process_context, usable_cores
from stepgap.control.reference import Reference
from stepgap.experiment.loop import Plants
from stepgap.experiment.noise_floor import measure_noise_floor
from stepgap.experiment.settings import PROCESS, Experiment
from stepgap.plants.plant import Plant
from stepgap.plants.process.line_channel import Child, Connection
from stepgap.plants.process.process_plant import ProcessPlant
from stepgap.plants.ticks.stream import OnTicks
from stepgap.records.summary import NoiseFloor
from stepgap.rigs.entry_points import rig_names
from stepgap.robots.entry_points import simulations_of
from stepgap.robots.robot import Simulation
from stepgap.step import StepMap

PLANTS = "stepgap.plants"  # Entry points of this group are callables `PlantRequest` → `Plants`
ANY_RIG = "any-rig"  # The plant of this name runs all rigs, which are found by their own names
LARGEST_PORT = 65535  # Largest TCP port


@dataclass(frozen=True, eq=False)
class PlantRequest:
    """What a plant is made from.

    Attributes:
        settings: Settings, which name and describe the plant.
        reference: Reference that will be tracked.
        folder: Folder of the run, into which a rig's ticks are written.
        arm: Whether a person allows torque on a rig.
        on_ticks: Called with the ticks of a simulation, if it has any.
        program: Command line of the program of the plant `process`, or `tcp:PORT`, where it listens.
        own: Makes the plant of a deployment from its random generator, instead of that of the settings.
    """

    settings: Experiment
    reference: Reference
    folder: Path
    arm: bool = False
    on_ticks: OnTicks | None = None
    program: Sequence[str] = ()
    own: Callable[[np.random.Generator], Plant] | None = None


def choose_plants(request: PlantRequest) -> Plants:
    """Chooses the plants of an experiment.

    Raises:
        InputError: No plant can be made with these settings.
    """
    if request.own:
        return Plants(request.own, replays=False)
    settings = request.settings
    name = request.settings.plant
    if request.program and name != PROCESS:
        raise InputError(f"-- {request.program[0]}: plant '{name}' runs no program; add --plant {PROCESS}")
    if settings.simulated:
        return _simulated(request)
    installed = [plant for plant in plugin_names(PLANTS) if plant != ANY_RIG]
    if name not in (*installed, *rig_names()) and not settings.rig:
        names = (*simulations_of(settings.robot), *installed, *rig_names())
        raise InputError(f"--plant {name}: unknown; it must be one of {', '.join(names)}")
    kind = name if name in installed else ANY_RIG
    return load_plugin(PLANTS, "plant", kind, callable, "callable with a PlantRequest")(request)


def refuse_rig_options(request: PlantRequest) -> None:
    """Raises InputError for options of a rig that were given with another plant."""
    if request.arm or request.settings.rig:
        raise InputError(f"--arm, --rig: only for real rigs; plant '{request.settings.plant}' takes neither")


def _simulated(request: PlantRequest) -> Plants:
    refuse_rig_options(request)
    simulation = simulation_of(request.settings)

    def measure(step_map: StepMap, rng: np.random.Generator, progress: Callable[[int, int], None]) -> NoiseFloor:
        threads = usable_cores() if simulation.unlocked else 1
        return measure_noise_floor(
            simulation.repeatable_plant, step_map, request.reference, rng, progress, threads=threads
        )

    return Plants(lambda rng: simulation.plant(rng, request.on_ticks), True, measure)


def simulation_of(settings: Experiment) -> Simulation:
    """The simulated plant of an experiment; the seed of the experiment draws its world.

    Raises:
        InputError: It cannot be made with these settings.
    """
    return simulations_of(settings.robot)[settings.plant](random_stream(settings.seed))


def process_plants(request: PlantRequest) -> Plants:
    """The plant `process`: the program that was given, or one that listens on a port.

    Raises:
        InputError: No program is given, it does not exist, or options of a rig are given.
    """
    refuse_rig_options(request)
    settings = request.settings
    program = request.program
    if not program:
        example = f"stepgap run --plant {PROCESS} -- ./robot, or -- tcp:5555 if it listens on that port"
        raise InputError(f"--plant {PROCESS}: give the robot's program after two dashes: {example}")
    port = re.fullmatch(r"tcp:(\d{1,5})", program[0]) if len(program) == 1 else None
    if port and not 0 < int(port[1]) <= LARGEST_PORT:
        raise InputError(f"-- {program[0]}: there is no such port; it must be 1 to {LARGEST_PORT}")
    if not port and shutil.which(program[0]) is None:
        raise InputError(f"-- {program[0]}: cannot be started: no such program; give its path, or a name in PATH")
    connect = partial(Connection, int(port[1])) if port else partial(Child, tuple(program))
    space = settings.space
    return Plants(lambda _: ProcessPlant(connect, space, settings.process, settings.robot.step_seconds), replays=False)


@contextmanager
def plant_compiled_beside(settings: Experiment) -> Iterator[None]:
    """Another process compiles the plant as soon as this one compiles within the block, and is awaited at its end.

    It leaves the code in the cache on disk, where this process finds it. It is only there to save time: what it cannot
    do, or make, is left to this process, which then reports the error.
    """
    others = list[BaseProcess]()

    def begin(functions: int, _seconds: float) -> None:
        if not functions:
            with suppress(Exception):
                other = process_context().Process(target=_compile_plant, args=(settings,), daemon=True)
                other.start()
                others.append(other)

    if not settings.simulated or usable_cores() < 2 or cache_folder() is None:
        yield
        return
    try:
        with on_compilation(begin):
            yield
        for other in others:
            other.join()
    finally:
        for other in others:
            other.terminate()
            other.join()


def _compile_plant(settings: Experiment) -> None:
    """Starts a plant, which calls all that its steps call."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the process that waits
    with suppress(Exception):
        if plant := simulation_of(settings).repeatable_plant(np.random.default_rng(0)):
            with plant:
                plant.start()
