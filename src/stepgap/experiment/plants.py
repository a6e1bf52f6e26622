"""Plants of `stepgap run`: the twin, also behind an emulated EtherCAT ring, another program, or a rig by name."""

import os
import re
import sys
from collections.abc import Callable, Sequence
from functools import partial
from math import tau
from pathlib import Path
from typing import NamedTuple

import numpy as np

from stepgap.base.errors import InputError
from stepgap.base.random_streams import random_stream
from stepgap.control.reference import Reference
from stepgap.experiment.loop import MeasureNoiseFloor, deployment_generator
from stepgap.experiment.noise_floor import measure_noise_floor
from stepgap.experiment.settings import EMULATED_RING, PROCESS, TWIN, Experiment
from stepgap.plants.commissioning.check import checked
from stepgap.plants.compiled_rig import Rows
from stepgap.plants.plant import Plant
from stepgap.plants.process.line_channel import Child, Connection
from stepgap.plants.process.process_plant import ProcessPlant
from stepgap.plants.realtime.process import RealtimeSetup
from stepgap.plants.realtime.realtime_plant import RealtimePlant
from stepgap.plants.rig_plant import RigPlant
from stepgap.records.summary import NoiseFloor
from stepgap.rigs.entry_points import load_rig, rig_names
from stepgap.rigs.ethercat.emulator.ring_settings import RingSettings
from stepgap.rigs.rig import Rig, RigFault
from stepgap.robots.hopper.direct_ring import DirectRing
from stepgap.robots.hopper.ethercat import RigSettings
from stepgap.robots.hopper.hop_control import HopperControl
from stepgap.robots.hopper.ring_rig import RingRig, emulated_settings
from stepgap.robots.hopper.twin.model import GroundProfile
from stepgap.robots.hopper.twin.twin import Twin
from stepgap.robots.hopper.twin_machine import TwinMachine
from stepgap.step import StepMap

SIMULATED = (TWIN, EMULATED_RING)
"""Plants whose deployments can be simulated again."""

RING = RingSettings(inputs_after_tick=True)
"""Settings of the emulated ring of a run."""


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
    on_ticks: Callable[[Rows], None] | None = None,
    program: Sequence[str] = (),
) -> Plants:
    """Chooses the plants of an experiment.

    Args:
        settings: Settings, which name and describe the plant.
        reference: Reference that will be tracked.
        arm: Whether a person allows torque on a rig.
        folder: Folder of the run, into which a rig's ticks are written.
        on_ticks: Called with the log rows of the ticks of a simulation, some at a time.
        program: Command line of the program of the plant `process`, or `tcp:PORT`, where it listens.

    Raises:
        InputError: No plant can be made with these settings.
    """
    simulated = settings.plant in SIMULATED
    if (simulated or settings.plant == PROCESS) and (arm or settings.rig):
        raise InputError(f"--arm, --rig: only for real rigs; plant '{settings.plant}' takes neither")
    if settings.plant == PROCESS:
        return _of_process(settings, program)
    if program:
        raise InputError(f"-- {program[0]}: plant '{settings.plant}' runs no program; add --plant {PROCESS}")
    if not simulated:
        return _of_rig(settings, arm, folder / "ticks")
    make_twin = partial(_twin, settings, _ground(settings))
    twin = make_twin(np.random.default_rng(0))

    def measure(step_map: StepMap, rng: np.random.Generator) -> NoiseFloor:
        twin = make_twin(rng)
        return measure_noise_floor(plant_on(settings, twin), twin, step_map, reference, rng)

    if settings.plant == TWIN:
        return Plants(lambda rng: plant_on(settings, make_twin(rng), on_ticks), True, measure)
    bus = _bus(settings, twin)

    def make_on_ring(rng: np.random.Generator) -> Plant:
        return plant_on(settings, RingRig(partial(_machine, settings, rng), RING, bus, settings.robot), on_ticks)

    return Plants(make_on_ring, True, measure)


def replay_rig(settings: Experiment, iteration: int) -> tuple[Rig, Twin]:
    """Rig of a recorded deployment, in its state before the first hop, and the twin in it.

    It repeats the motion of the run tick by tick. An emulated ring is left out, and its faults are not reproduced.

    Raises:
        InputError: The plant was not simulated, or no twin can be made with the settings.
    """
    if settings.plant not in SIMULATED:
        raise InputError(
            f"plant '{settings.plant}': a deployment of a rig cannot be simulated again; its ticks are in ticks/"
        )
    twin = _twin(settings, _ground(settings), deployment_generator(settings.seed, iteration))
    rig = twin if settings.plant == TWIN else DirectRing(twin, RING, _bus(settings, twin))
    return rig, twin


def _ground(settings: Experiment) -> GroundProfile:
    return GroundProfile(settings.gap, settings.robot.boom_length, random_stream(settings.seed))


def _twin(settings: Experiment, ground: GroundProfile, rng: np.random.Generator) -> Twin:
    floor_yaw = rng.uniform(0, tau)  # otherwise every deployment would reach a target at the same yaw
    try:
        return Twin(settings.robot, settings.gap, rng, ground=ground, floor_yaw=floor_yaw)
    except ValueError as error:
        raise InputError(f"no twin can be made with the settings [robot] and [gap]: {error}") from None


def plant_on(settings: Experiment, rig: Rig, on_ticks: Callable[[Rows], None] | None = None) -> RigPlant:
    """Plant of a simulated rig."""
    return RigPlant(rig, HopperControl(settings.robot, settings.gains, settings.command), on_ticks)


def _machine(settings: Experiment, rng: np.random.Generator) -> TwinMachine:
    """Machine behind the drives of an emulated ring; called in the ring's process."""
    return TwinMachine(_twin(settings, _ground(settings), rng))


def _bus(settings: Experiment, twin: Twin) -> RigSettings:
    """Settings of the master of an emulated ring."""
    for name in ("motor_counts", "boom_counts_horizontal", "boom_counts_vertical"):
        if not np.isfinite(getattr(settings.gap, name)):
            raise InputError(f"gap.{name} must be finite: a ring carries integer counts, such as {name} = 16384")
    return emulated_settings(twin.sensor_model, settings.robot, RING, f"sg{os.getpid()}")  # several runs may be active


def _of_rig(settings: Experiment, arm: bool, logs: Path) -> Plants:
    if not settings.rig:
        plants = (*SIMULATED, PROCESS, *rig_names())
        if settings.plant not in plants:
            raise InputError(f"--plant {settings.plant}: unknown; it must be one of {', '.join(plants)}")
        raise InputError(f"--plant {settings.plant}: give the rig's file by --rig RIG.toml")
    make_rig = partial(load_rig, settings.plant, Path(settings.rig), settings.robot)
    make_rig()  # reports errors before the first deployment
    if not arm:
        raise InputError(
            f"--plant {settings.plant}: gives torque only with --arm; `stepgap rig dry-run` tests all but torque"
        )
    setup = RealtimeSetup(make_rig, HopperControl(settings.robot, settings.gains, settings.command))

    def make(_: np.random.Generator) -> Plant:
        checked(Path(settings.rig))  # every deployment reads the file again
        return RealtimePlant(setup, logs, ask_to_hold)

    checked(Path(settings.rig))
    return Plants(make, replays=False)


def _of_process(settings: Experiment, program: Sequence[str]) -> Plants:
    if not program:
        example = f"stepgap run --plant {PROCESS} -- ./robot, or -- tcp:5555 if it listens on that port"
        raise InputError(f"--plant {PROCESS}: give the robot's program after two dashes: {example}")
    port = re.fullmatch(r"tcp:(\d{1,5})", program[0]) if len(program) == 1 else None
    connect = partial(Connection, int(port[1])) if port else partial(Child, tuple(program))
    space = settings.command.space()
    return Plants(lambda _: ProcessPlant(connect, space, settings.process), replays=False)


def ask_to_hold() -> None:
    """Waits until a person holds the robot.

    Raises:
        RigFault: There is no answer.
    """
    if sys.stdin.isatty():
        import termios  # not available on Windows

        termios.tcflush(sys.stdin, termios.TCIFLUSH)  # earlier input is not an answer
    print(
        "Hold the robot up with its foot off the ground and press Enter: it takes its landing posture within half a "
        "second. Then release it. Ctrl-C lands it.",
        file=sys.stderr,
    )
    if not sys.stdin.readline():
        raise RigFault("Enter was not pressed, so no torque was given")
